"""What a fit gives: draws, parameters, residuals, InferenceData; one surface for all methods."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.infer import _diagnostics, _export
from maloc.infer._arviz import as_arviz
from maloc.infer._fit import Fitted
from maloc.infer.marginal import MarginalFit
from maloc.infer.predict import Prediction, TrackDraws, predict, sample_tracks

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Fit", "LaplaceFit", "SampledFit"]


class Fit(Fitted):
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
    source : ArrivalTimes, EncounterHistory, ArrivalHistory or None
        What was fitted, where it was one of them.
    notices : tuple of str
        What the fit decided of itself.
    """

    notices: tuple[str, ...] = ()

    def predict(self, times, tag: int = 0) -> Prediction:
        """Posterior of a tag's state at any times (n,), s: see `maloc.infer.predict`."""
        return predict(self, times, tag)

    def sample_tracks(
        self, times, tag: int = 0, *, n: int = 200, seed: int = 0, **known: Any
    ) -> TrackDraws:
        """Whole tracks of a tag drawn at ascending times (n,), s: see `maloc.infer.predict`."""
        return sample_tracks(self, times, tag, n=n, seed=seed, **known)

    def parameters(self) -> list[dict[str, Any]]:
        """One row a parameter: name, mean, sd, q2.5, q97.5, ess_bulk, ess_tail, r_hat, unit."""
        if "parameters" not in self._known:
            self._known["parameters"] = _diagnostics.parameter_rows(self)
        return self._known["parameters"]

    def summary(self) -> str:
        """The parameters as a small text table."""
        return _diagnostics.parameter_text(self.parameters())

    def to_datatree(
        self,
        *,
        log_likelihood: str = "ping",
        predictive: bool = False,
        log_prior: bool = False,
        seed: int = 0,
    ) -> xr.DataTree:
        """Posterior as an `xarray.DataTree` (what ``posterior.nc`` holds).

        Parameters
        ----------
        log_likelihood : {"ping", "value"}
            One array, an entry a ping (what ``az.loo`` takes as it is), or one for each kind of
            data, an entry a value, as ``az.loo_pit`` wants it.
        predictive : bool
            Add ``posterior_predictive``: data replicated at every draw.
        log_prior : bool
            Add ``log_prior``: log density of each latent site at every draw.
        seed : int
            Of the replicated data.

        Returns
        -------
        xarray.DataTree
            Groups posterior (parameters first), log_likelihood, sample_stats, observed_data,
            constant_data; unheard (rows of track.csv that are predictions), and what
            `maloc.predict` needs. The dimension ``ping`` has coordinates ping (id in the input),
            time, heard, row (in track.csv, from 0) and ping_tag; axis is x, y; receiver has names;
            units are attributes. See docs/posterior.md.
        """
        how = {"log_likelihood": log_likelihood, "predictive": predictive}
        return _export.to_datatree(self, **how, log_prior=log_prior, seed=seed)

    def to_inference_data(self, **how: Any):
        """Posterior as the installed ArviZ has it; parameters as for `to_datatree`.

        Returns
        -------
        arviz.InferenceData or xarray.DataTree
            Of ArviZ 0.x an InferenceData; ArviZ 1.x works on the DataTree. The same groups.
        """
        return as_arviz(self.to_datatree(**how))


class LaplaceFit(Fit):
    """Gaussian approximation at the mode; ``marginal`` holds the mode, factor and covariance."""

    method = "laplace"

    def __init__(
        self, cm, args, options, seconds, warnings, marginal: MarginalFit, n: int, seed: int
    ) -> None:
        super().__init__(cm, args, options, seconds, warnings)
        self.marginal, self.n, self.seed = marginal, n, seed

    def flat_draws(
        self, n: int | None = None, seed: int | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Draws of parameters, then of the path given them, from the factor."""
        m = self.marginal
        n, seed = self.n if n is None else n, self.seed if seed is None else seed
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

    def flat_draws(
        self, n: int | None = None, seed: int | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """All draws."""
        return self.x, self.u

    def moments(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean (T, d) and covariance (T, d, d) of the draws."""
        flat = self.x[:, :, : self.n_states].reshape(-1, self.n_states, self.cm.d)
        mean = flat.mean(axis=0)
        off = flat - mean
        return mean, np.einsum("nti,ntj->tij", off, off) / (len(flat) - 1)
