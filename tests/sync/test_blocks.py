import numpy as np
import pytest

from maloc.sync import _blocks


def chain(rng, k, n):
    a = rng.normal(size=(k * n, k * n))
    full = a @ a.T + k * n * np.eye(k * n)
    block = np.arange(k * n) // n
    full[np.abs(block[:, None] - block[None]) > 1] = 0.0
    full += 3 * np.abs(full).sum(1).max() * np.eye(k * n)
    cube = full.reshape(k, n, k, n)
    diag = np.array([cube[i, :, i] for i in range(k)])
    off = np.array([cube[i, :, i + 1] for i in range(k - 1)]).reshape(k - 1, n, n)
    return full, diag, off


@pytest.mark.parametrize(("k", "n"), [(1, 3), (2, 1), (7, 4)])
def test_solve_and_selected_inverse_agree_with_dense_algebra(k, n):
    rng = np.random.default_rng(0)
    full, diag, off = chain(rng, k, n)
    f = _blocks.factor(diag, off)
    b = rng.normal(size=(k, n, 2))
    expected = np.linalg.solve(full, b.reshape(k * n, 2)).reshape(k, n, 2)
    np.testing.assert_allclose(_blocks.solve(f, b), expected, rtol=1e-10)
    inverse = np.linalg.inv(full).reshape(k, n, k, n)
    own, next_ = _blocks.selected_inverse(f)
    for i in range(k):
        np.testing.assert_allclose(own[i], inverse[i, :, i], rtol=1e-9, atol=1e-15)
        if i < k - 1:
            np.testing.assert_allclose(next_[i], inverse[i, :, i + 1], rtol=1e-8, atol=1e-15)


def test_not_positive_definite_raises():
    with pytest.raises(np.linalg.LinAlgError, match="block 1"):
        _blocks.factor(np.array([np.eye(2), -np.eye(2)]), np.zeros((1, 2, 2)))
