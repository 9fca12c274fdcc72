"""What a fit holds and works out of itself: draws, positions, residuals, likelihoods."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from maloc._jax import jnp
from maloc.data._limits import Z95
from maloc.data._stages import Stages
from maloc.infer import _dims
from maloc.infer._model import ChainModel
from maloc.model_data.clock_pings import ClockPings
from maloc.model_data.encounters import EncounterData
from maloc.model_data.joint import JointData
from maloc.model_data.toa import ToaData
from maloc.world.habitat import Water

if TYPE_CHECKING:
    from maloc.infer.marginal import MarginalFit

__all__ = ["Fitted"]


class Fitted:
    """A fitted chain model, as all methods share it; `maloc.infer.Fit` is what users hold.

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
    marginal : MarginalFit
        Of a Laplace fit alone.
    """

    method = ""
    marginal: MarginalFit

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

    def _unpadded(self, name: str, value: np.ndarray) -> np.ndarray:
        present = getattr(self.args[0], "present", None) if self.args else None
        return _dims.cut(self.cm, name, value, self.cm.length(self.args), self.n_states, present)

    def dims(self, name: str) -> tuple[str, ...]:
        """Dimensions of a site of `draws`, chain and draw aside; time is the first."""
        return _dims.dims_of(self.cm, name, self.draws()[name].shape[2:], self.n_states)

    @property
    def parameter_names(self) -> list[str]:
        """Sites of `draws` that do not run along time; receivers' effects in metres alone."""
        raw = {site.name for site in self.cm.globals if site.inner}
        names = [k for k in self.draws() if _dims.along(self.cm) not in self.dims(k)]
        names = [name for name in names if name not in raw]
        return sorted(names, key=lambda name: "receiver" in self.dims(name))  # else in their order

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

        Of `maloc.models.clock_sync`, as `residuals`, (K, M, D): see `maloc.model_data.clock_pings`.
        """
        return self._mean_part("p_direct")

    def residuals(self) -> np.ndarray:
        """Posterior mean residual of each arrival (s), (T, R); NaN where not heard."""
        found, data = self._mean_part("residual"), self.args[0]
        if isinstance(data, ClockPings):  # whose arrivals are times, ms; all others' are ranges
            return 1e-3 * found
        return found / np.asarray(data.speed)[: self.n_states, None]


def _flat_pair(x: np.ndarray, u: np.ndarray):
    draws = x.shape[0] * x.shape[1]
    return jnp.asarray(x.reshape(draws, *x.shape[2:])), jnp.asarray(u.reshape(draws, -1))
