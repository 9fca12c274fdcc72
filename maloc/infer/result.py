"""What a fit gives: draws, parameters, residuals, InferenceData; one surface for all methods."""

from __future__ import annotations

from typing import Any

import numpy as np

from maloc._jax import jax, jnp
from maloc.data.model_data import ToaData
from maloc.infer import _diagnostics
from maloc.infer._model import ChainModel
from maloc.infer._stages import Stages
from maloc.infer.marginal import MarginalFit

__all__ = ["Fit", "LaplaceFit", "SampledFit"]


class Fit:
    """A fitted chain model (common surface of all methods).

    Attributes
    ----------
    method : str
        "laplace", "nuts" or "hmc".
    options : dict
        The model's static options.
    seconds : dict
        Stage -> {"wall", "cpu"} seconds.
    warnings : tuple of str
        What went less than well; empty for a clean fit.
    """

    method = ""

    def __init__(
        self, cm: ChainModel, args: tuple, options: dict, seconds: Stages, warnings: tuple[str, ...]
    ) -> None:
        self.cm, self.args, self.options = cm, args, dict(options)
        self.seconds, self.warnings = seconds, warnings

    def __repr__(self) -> str:
        cpu = sum(s["cpu"] for s in self.seconds.values())
        state = "; ".join(self.warnings) or "no warnings"
        return (
            f"{type(self).__name__}({self.model_name}, {self.n_states} states, "
            f"{self.cm.k} parameters, {cpu:.1f} CPU s, {state})"
        )

    @property
    def model_name(self) -> str:
        """Name of the model function."""
        return getattr(self.cm.model, "__name__", type(self.cm.model).__name__)

    @property
    def n_states(self) -> int:
        """States of the chain without padding: heard pings."""
        if self.args and isinstance(self.args[0], ToaData):
            return int(np.asarray(self.args[0].valid).sum())
        return self.cm.length(self.args)

    def flat_draws(self, n: int = 1000, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Flat draws: path (chain, draw, T, d) and unconstrained parameters (chain, draw, k)."""
        raise TypeError(f"{type(self).__name__} has no draws")

    def moments(self) -> tuple[np.ndarray, np.ndarray]:
        """Posterior mean (T, d) and covariance (T, d, d) of each state, padding left out."""
        raise TypeError(f"{type(self).__name__} has no moments")

    def draws(self, n: int = 1000, seed: int = 0) -> dict[str, np.ndarray]:
        """Draws of all latent and deterministic sites in natural space, (chain, draw, ...).

        Parameters
        ----------
        n : int
            Draws from a Laplace fit; a sampled fit returns the draws it has.
        seed : int
            Seed of a Laplace fit's draws.
        """
        x, u = self.flat_draws(n, seed)
        length = x.shape[2]
        values = jax.lax.map(lambda xu: self.cm.natural(*xu, self.args), _flat_pair(x, u))
        out = {}
        for name, value in values.items():
            value = np.asarray(value).reshape(*x.shape[:2], *value.shape[1:])
            if value.ndim > 2 and value.shape[2] == length:
                value = value[:, :, : self.n_states]
            out[name] = value
        return out

    def pointwise(self, n: int = 1000, seed: int = 0) -> dict[str, np.ndarray]:
        """Log likelihood of each observed value that counts, site -> (chain, draw, values)."""
        x, u = self.flat_draws(n, seed)

        def one(xu):
            parts = self.cm.pointwise(*xu, self.args)
            return {k: v["log_likelihood"] for k, v in parts.items()}

        values = jax.lax.map(one, _flat_pair(x, u), batch_size=50)
        masks = self.cm.pointwise(x[0, 0], u[0, 0], self.args)
        out = {}
        for name, value in values.items():
            value = np.asarray(value).reshape(*x.shape[:2], -1)
            mask = masks[name].get("mask")
            if mask is not None:
                value = value[:, :, np.broadcast_to(np.asarray(mask), mask.shape).ravel()]
            elif masks[name]["log_likelihood"].ndim == 0:
                continue  # factors are no data
            out[name] = value
        return out

    def _mean_part(self, part: str, n: int = 200, seed: int = 0) -> np.ndarray:
        """Posterior mean of a part of the first observed site that has it, (T, R)."""
        x, u = self.flat_draws(n, seed)
        x, u = x[:, :: max(1, x.shape[1] // n)], u[:, :: max(1, u.shape[1] // n)]

        def one(xu):
            parts = self.cm.pointwise(*xu, self.args)
            return next(v[part] for v in parts.values() if part in v)

        mean = np.asarray(jax.lax.map(one, _flat_pair(x, u), batch_size=50)).mean(axis=0)
        heard = np.asarray(self.args[0].heard)[: self.n_states]
        return np.where(heard, mean[: self.n_states], np.nan)

    def p_direct(self) -> np.ndarray:
        """Posterior probability that each arrival is direct, (T, R); NaN where not heard."""
        return self._mean_part("p_direct")

    def residuals(self) -> np.ndarray:
        """Posterior mean residual of each arrival (s), (T, R); NaN where not heard."""
        speed = np.asarray(self.args[0].speed)[: self.n_states]
        return self._mean_part("residual") / speed[:, None]

    def parameters(self) -> list[dict[str, Any]]:
        """One row a parameter: name, mean, sd, q2.5, q97.5, ess_bulk, ess_tail, r_hat, unit."""
        return _diagnostics.parameter_rows(self)

    def summary(self) -> str:
        """The parameters as a small text table."""
        return _diagnostics.parameter_text(self)

    def to_datatree(self):
        """Posterior as an `xarray.DataTree` (what ``posterior.nc`` holds)."""
        from maloc.infer import _export

        return _export.to_datatree(self)

    def to_inference_data(self):
        """Posterior as ArviZ InferenceData."""
        from maloc.infer import _export

        return _export.to_inference_data(self)


def _flat_pair(x: np.ndarray, u: np.ndarray):
    draws = x.shape[0] * x.shape[1]
    return jnp.asarray(x.reshape(draws, *x.shape[2:])), jnp.asarray(u.reshape(draws, -1))


class LaplaceFit(Fit):
    """Gaussian approximation at the mode; ``marginal`` holds the mode, factor and covariance."""

    method = "laplace"

    def __init__(self, cm, args, options, seconds, warnings, marginal: MarginalFit) -> None:
        super().__init__(cm, args, options, seconds, warnings)
        self.marginal = marginal

    def flat_draws(self, n: int = 1000, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Draws of parameters, then of the path given them, from the factor."""
        m = self.marginal
        rng = np.random.default_rng(seed)
        root = np.linalg.cholesky(m.covariance) if self.cm.k else np.zeros((0, 0))
        delta = rng.standard_normal((n, self.cm.k)) @ root.T
        noise = m.factor.unwhiten(rng.standard_normal((n, *m.x.shape)))
        x = m.x + np.einsum("nk,ktd->ntd", delta, m.slope) + noise
        return x[None], (m.u + delta)[None]

    def moments(self) -> tuple[np.ndarray, np.ndarray]:
        """Mode (T, d) and covariance (T, d, d), the parameters' uncertainty included."""
        m, length = self.marginal, self.n_states
        spread = np.einsum("kti,kl,ltj->tij", m.slope, m.covariance, m.slope)
        return m.x[:length], (m.factor.covariances() + spread)[:length]


class SampledFit(Fit):
    """Markov chain draws: ``x`` (chain, draw, T, d), ``u`` (chain, draw, k), ``stats`` by name."""

    def __init__(self, cm, args, options, seconds, warnings, method, x, u, stats) -> None:
        super().__init__(cm, args, options, seconds, warnings)
        self.method, self.x, self.u, self.stats = method, x, u, stats

    def flat_draws(self, n: int = 1000, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """All draws."""
        return self.x, self.u

    def moments(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean (T, d) and covariance (T, d, d) of the draws."""
        flat = self.x[:, :, : self.n_states].reshape(-1, self.n_states, self.cm.d)
        mean = flat.mean(axis=0)
        off = flat - mean
        return mean, np.einsum("nti,ntj->tij", off, off) / (len(flat) - 1)
