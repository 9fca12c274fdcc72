"""What a fit gives: draws, parameters, residuals, InferenceData; one surface for all methods."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from maloc._jax import jnp
from maloc._limits import Z95
from maloc._stages import Stages
from maloc.data.clock_pings import ClockPings
from maloc.data.encounter_data import EncounterData
from maloc.data.joint_data import JointData
from maloc.data.model_data import ToaData
from maloc.habitat import Water
from maloc.infer import _diagnostics, _dims
from maloc.infer._model import ChainModel
from maloc.infer.marginal import MarginalFit

if TYPE_CHECKING:
    import xarray as xr

    from maloc.infer.predict import Prediction, TrackDraws

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
    source : ArrivalTimes, EncounterHistory, ArrivalHistory or None
        What was fitted, where it was one of them.
    """

    method = ""

    def __init__(
        self, cm: ChainModel, args: tuple, options: dict, seconds: Stages, warnings: tuple[str, ...]
    ) -> None:
        self.cm, self.args, self.options = cm, args, dict(options)
        self.seconds, self.warnings = seconds, warnings
        self.source: Any = None  # the container that was fitted, where it was one
        self._known: dict = {}  # what was worked out already

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
        """States of the chain without padding."""
        if self.args and isinstance(self.args[0], ToaData | EncounterData | JointData):
            return int(np.asarray(self.args[0].valid).sum())
        return self.cm.length(self.args)

    @property
    def water(self) -> Water | None:
        """What keeps the animals off the land, where the model was given it."""
        return next((a for a in self.args[1:] if isinstance(a, Water)), None)

    def positions(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Mean (T, 2), covariance (T, 2, 2) and central 95 % limits (T, 2) twice of positions, m.

        Of a Laplace fit by its normal law, of any other and with water by the draws.
        """
        n = self.n_states
        site = next(s for s in self.cm.chain if s.name == "track")
        xy = [site.columns.start, site.columns.start + 1]
        if self.method == "laplace" and self.water is None:
            mean, covariance = self.moments()
            mean, covariance = mean[:, xy], covariance[:, xy][:, :, xy]
            half = Z95 * np.sqrt(np.einsum("tii->ti", covariance))
            return mean, covariance, mean - half, mean + half
        path = (
            self.flat_draws()[0][:, :, :n, xy] if self.water is None else self.draws()["position"]
        )
        flat = path.reshape(-1, n, 2)
        mean = flat.mean(axis=0)
        off = flat - mean
        covariance = np.einsum("nti,ntj->tij", off, off) / (len(flat) - 1)
        return mean, covariance, *np.quantile(flat, [0.025, 0.975], axis=0)

    def depths(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None:
        """Mean, sd and central 95 % limits, each (T,) m, of the depth by the draws.

        None where the track is flat.
        """
        if not self.args or getattr(self.args[0], "depth", None) is None:
            return None
        flat = self.draws()["depth"]
        flat = flat.reshape(-1, flat.shape[-1])
        return flat.mean(axis=0), flat.std(axis=0), *np.quantile(flat, [0.025, 0.975], axis=0)

    def flat_draws(
        self, n: int | None = None, seed: int | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Flat draws: path (chain, draw, T, d) and unconstrained parameters (chain, draw, k)."""
        raise TypeError(f"{type(self).__name__} has no draws")

    def moments(self) -> tuple[np.ndarray, np.ndarray]:
        """Posterior mean (T, d) and covariance (T, d, d) of each state, padding left out."""
        raise TypeError(f"{type(self).__name__} has no moments")

    def mapping(self) -> Any:
        """The whitening map to sample from."""
        raise TypeError(f"{type(self).__name__} is no start for a sampler")

    def draws(self, n: int | None = None, seed: int | None = None) -> dict[str, np.ndarray]:
        """Draws of all latent and deterministic sites in natural space, (chain, draw, ...).

        Parameters
        ----------
        n, seed : int, optional
            Draws from a Laplace fit and their seed, where they are not to be those of the fit's
            other outputs; a sampled fit returns the draws it has.
        """
        key = ("draws", n, seed)
        if key not in self._known:
            x, u = self.flat_draws(n, seed)
            values = self.cm.naturals(*_flat_pair(x, u), self.args)
            self._known[key] = {
                name: self._unpadded(name, np.asarray(v).reshape(*x.shape[:2], *v.shape[1:]))
                for name, v in values.items()
            }
        return self._known[key]

    def predict(self, times, tag: int = 0) -> Prediction:
        """Posterior of a tag's state at any times (n,), s: see `maloc.infer.predict`."""
        from maloc.infer.predict import predict

        return predict(self, times, tag)

    def sample_tracks(
        self, times, tag: int = 0, *, n: int = 200, seed: int = 0, **known: Any
    ) -> TrackDraws:
        """Whole tracks of a tag drawn at ascending times (n,), s: see `maloc.infer.predict`."""
        from maloc.infer.predict import sample_tracks

        return sample_tracks(self, times, tag, n=n, seed=seed, **known)

    def _unpadded(self, name: str, value: np.ndarray) -> np.ndarray:
        present = getattr(self.args[0], "present", None) if self.args else None
        return _dims.cut(self.cm, name, value, self.cm.length(self.args), self.n_states, present)

    def dims(self, name: str) -> tuple[str, ...]:
        """Dimensions of a site of `draws`, chain and draw aside; time is the first."""
        return _dims.dims_of(self.cm, name, self.draws()[name].shape[2:], self.n_states)

    @property
    def parameter_names(self) -> list[str]:
        """Sites of `draws` that do not run along time."""
        return [k for k in self.draws() if _dims.along(self.cm) not in self.dims(k)]

    def _arrivals(self) -> tuple[dict, dict, dict]:
        """Of the observed sites log likelihoods (chain, draw, values), means of the rest, sums.

        Sums (chain, draw, n) are over all axes of a site's value but the first.
        """
        if "arrivals" not in self._known:
            x, u = self.flat_draws()
            density, means = self.cm.likelihoods(*_flat_pair(x, u), self.args)
            out, sums = {}, {}
            for name, value in density.items():
                if value.ndim == 1:
                    continue  # factors are no data
                value = np.asarray(value)
                mask = means[name].get("mask")
                each = value.reshape(*value.shape[:2], -1)
                if mask is None:
                    value = value.reshape(len(value), -1)
                else:
                    on = np.broadcast_to(np.asarray(mask) > 0, value.shape[1:])
                    each = np.where(on.reshape(each.shape[1:]), each, 0.0)
                    value = value[:, on]
                out[name] = value.reshape(*x.shape[:2], -1)
                sums[name] = each.sum(axis=2).reshape(*x.shape[:2], -1)
            self._known["arrivals"] = out, means, sums
        return self._known["arrivals"]

    def pointwise(self) -> dict[str, np.ndarray]:
        """Log likelihood of each observed value that counts, site -> (chain, draw, values)."""
        return self._arrivals()[0]

    def _mean_part(self, part: str) -> np.ndarray:
        """Posterior mean of a part of the first observed site that has it, (T, R)."""
        mean = next(np.asarray(v[part]) for v in self._arrivals()[1].values() if part in v)
        data = self.args[0]
        mean = np.where(np.asarray(data.heard), mean, np.nan)[: self.n_states]
        return mean if isinstance(data, ClockPings) else mean[:, np.asarray(data.present)]

    def p_direct(self) -> np.ndarray:
        """Posterior probability that each arrival is direct, (T, R); NaN where not heard.

        Of `maloc.models.clock_sync`, as `residuals`, (K, M, D): see `maloc.data.clock_pings`.
        """
        return self._mean_part("p_direct")

    def residuals(self) -> np.ndarray:
        """Posterior mean residual of each arrival (s), (T, R); NaN where not heard."""
        found, data = self._mean_part("residual"), self.args[0]
        if isinstance(data, ClockPings):  # whose arrivals are times, ms; all others' are ranges
            return 1e-3 * found
        return found / np.asarray(data.speed)[: self.n_states, None]

    def parameters(self) -> list[dict[str, Any]]:
        """One row a parameter: name, mean, sd, q2.5, q97.5, ess_bulk, ess_tail, r_hat, unit."""
        if "parameters" not in self._known:
            self._known["parameters"] = _diagnostics.parameter_rows(self)
        return self._known["parameters"]

    def summary(self) -> str:
        """The parameters as a small text table."""
        return _diagnostics.parameter_text(self)

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
        from maloc.infer import _export

        how = {"log_likelihood": log_likelihood, "predictive": predictive}
        return _export.to_datatree(self, **how, log_prior=log_prior, seed=seed)

    def to_inference_data(self, **how: Any):
        """Posterior as the installed ArviZ has it; parameters as for `to_datatree`.

        Returns
        -------
        arviz.InferenceData or xarray.DataTree
            Of ArviZ 0.x an InferenceData; ArviZ 1.x works on the DataTree. The same groups.
        """
        from maloc.infer._arviz import as_arviz

        return as_arviz(self.to_datatree(**how))


def _flat_pair(x: np.ndarray, u: np.ndarray):
    draws = x.shape[0] * x.shape[1]
    return jnp.asarray(x.reshape(draws, *x.shape[2:])), jnp.asarray(u.reshape(draws, -1))


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
