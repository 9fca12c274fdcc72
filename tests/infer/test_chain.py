"""Band algebra against dense linear algebra."""

import numpy as np
import pytest

from maloc.infer._chain import ChainFactor
from maloc.infer._map import unwhiten
from tests.oracles import from_band


def banded(length, d, seed=0):
    """A positive definite block-tridiagonal matrix: lower band (2 d, T d) and dense."""
    rng = np.random.default_rng(seed)
    n = length * d
    root = np.zeros((n, n))
    for t in range(length):
        here = slice(t * d, (t + 1) * d)
        root[here, here] = np.tril(rng.normal(size=(d, d)), -1) + np.diag(rng.uniform(1, 3, d))
        if t:
            root[here, (t - 1) * d : t * d] = rng.normal(size=(d, d))
    dense = root @ root.T
    band = np.zeros((2 * d, n))
    for offset in range(min(2 * d, n)):
        band[offset, : n - offset] = np.diag(dense, -offset)
    return band, dense


@pytest.mark.parametrize(("length", "d"), [(1, 3), (2, 1), (7, 1), (9, 5)])
class TestFactor:
    def test_log_det_and_solve(self, length, d):
        band, dense = banded(length, d)
        factor = ChainFactor(band, d)
        np.testing.assert_allclose(from_band(band), dense)
        np.testing.assert_allclose(factor.log_det, np.linalg.slogdet(dense)[1], rtol=1e-12)
        diagonal = np.diag(np.linalg.cholesky(dense)).reshape(length, d)
        np.testing.assert_allclose(factor.log_diagonal, np.log(diagonal), atol=1e-10)
        rhs = np.random.default_rng(1).normal(size=(4, length, d))
        wanted = np.linalg.solve(dense, rhs.reshape(4, -1).T).T.reshape(rhs.shape)
        np.testing.assert_allclose(factor.solve(rhs), wanted, rtol=1e-9, atol=1e-11)
        np.testing.assert_allclose(factor.solve(rhs[0]), wanted[0], rtol=1e-9, atol=1e-11)

    def test_unwhiten(self, length, d):
        band, dense = banded(length, d)
        z = np.random.default_rng(2).normal(size=(3, length, d))
        wanted = np.linalg.solve(np.linalg.cholesky(dense).T, z.reshape(3, -1).T).T
        np.testing.assert_allclose(
            ChainFactor(band, d).unwhiten(z), wanted.reshape(z.shape), rtol=1e-9, atol=1e-11
        )

    def test_covariances(self, length, d):
        band, dense = banded(length, d)
        inverse = np.linalg.inv(dense).reshape(length, d, length, d)
        wanted = inverse[np.arange(length), :, np.arange(length)]
        np.testing.assert_allclose(ChainFactor(band, d).covariances(), wanted, atol=1e-11)

    def test_doubled(self, length, d):
        """All powers: L^-T exactly; three: its blocks up to seven states ahead, and no others."""
        band, dense = banded(length, d)
        wanted = np.linalg.inv(np.linalg.cholesky(dense)).T
        blocks = wanted.reshape(length, d, length, d)
        far = np.subtract.outer(np.arange(length), np.arange(length)).T > 7
        near = np.where(far[:, None, :, None], 0.0, blocks).reshape(wanted.shape)
        eye = np.eye(length * d).reshape(-1, length, d)
        for most, expected in ((16, wanted), (3, near)):
            root, powers = ChainFactor(band, d).doubled(most, tol=0.0)
            assert root.shape == (length, d, d)
            assert powers.shape[1:] == (length, d, d)
            columns = [np.asarray(unwhiten(root, powers, z)).ravel() for z in eye]
            np.testing.assert_allclose(np.transpose(columns), expected, atol=1e-10)


def test_doubling_ends_where_nothing_is_carried_further():
    """Strong data at every state: three shifts. A free random walk: as many as it is long."""
    for strength, levels in ((100.0, 3), (1e-9, 9)):
        band = np.zeros((2, 300))
        band[0], band[1, :-1] = 2.0 + strength, -1.0
        assert len(ChainFactor(band, 1).doubled()[1]) == levels


@pytest.mark.parametrize("spoil", [np.nan, np.inf, -1.0])
def test_no_factor(spoil):
    band, _ = banded(5, 3)
    band[0, 7] = spoil
    with pytest.raises(np.linalg.LinAlgError):
        ChainFactor(band, 3)
