"""Convergence diagnostics against ArviZ."""

import arviz as az
import numpy as np
import pytest

from maloc.infer._diagnostics import ess_bulk, ess_tail, r_hat


def autocorrelated(rng, chains, n, phi):
    out = np.empty((chains, n))
    out[:, 0] = rng.normal(size=chains)
    for t in range(1, n):
        out[:, t] = phi * out[:, t - 1] + np.sqrt(1 - phi**2) * rng.normal(size=chains)
    return out


def made(rng, chains, n):
    """Draws by what is the matter with them."""
    mixed = autocorrelated(rng, chains, n, 0.3)
    stuck = autocorrelated(rng, chains, n, 0.2)
    stuck[0] += 4.0
    wide = rng.normal(size=(chains, n)) * np.where(np.arange(chains) == 0, 5.0, 1.0)[:, None]
    return {
        "independent": rng.normal(size=(chains, n)),
        "slow": autocorrelated(rng, chains, n, 0.97),
        "antithetic": autocorrelated(rng, chains, n, -0.7),
        "heavy": rng.standard_cauchy((chains, n)),
        "several modes": mixed + 6.0 * (autocorrelated(rng, chains, n, 0.95) > 0),
        "one chain elsewhere": stuck,
        "one chain wider": wide,
        "ties": np.round(mixed),
        "hanging": np.repeat(rng.normal(size=(chains, n // 20 + 1)), 20, axis=1)[:, :n],
    }


@pytest.mark.parametrize(("chains", "n"), [(2, 100), (2, 333), (4, 1000)])
def test_same_as_arviz(chains, n):
    for name, draws in made(np.random.default_rng(n), chains, n).items():
        ours = (
            r_hat(draws[..., None])[0],
            ess_bulk(draws[..., None])[0],
            ess_tail(draws[..., None])[0],
        )
        theirs = (
            float(az.rhat(draws)),
            float(az.ess(draws, method="bulk")),
            float(az.ess(draws, method="tail")),
        )
        np.testing.assert_allclose(ours, theirs, rtol=1e-6, err_msg=name)


def test_many_coordinates_at_once():
    rng = np.random.default_rng(0)
    draws = np.stack([autocorrelated(rng, 2, 200, p) for p in np.linspace(-0.5, 0.95, 6)], axis=-1)
    together = draws.reshape(2, 200, 3, 2)
    for function in (r_hat, ess_bulk, ess_tail):
        one = [function(draws[..., i : i + 1])[0] for i in range(6)]
        np.testing.assert_allclose(function(together), np.reshape(one, (3, 2)), rtol=1e-12)


def test_a_constant_has_no_r_hat():
    still = np.ones((2, 100, 1))
    assert np.isnan(r_hat(still)).all()
    assert ess_bulk(still)[0] == az.ess(still[..., 0], method="bulk") == 200
