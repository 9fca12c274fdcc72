"""Convergence diagnostics of Markov chains: rank-normalised split R-hat, bulk and tail ESS.

Vehtari, Gelman, Simpson, Carpenter & Burkner (2021) Rank-normalization, folding, and
localization. Bayesian Analysis 16(2): 667-718. Vectorised over thousands of coordinates, which
ArviZ is not; tests compare the two.
"""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import ndtri

if TYPE_CHECKING:
    from maloc.infer._fit import Fitted

__all__ = ["ess_bulk", "ess_tail", "parameter_rows", "parameter_text", "r_hat"]


def _split(draws: np.ndarray) -> np.ndarray:
    """(chain, draw, ...) -> (2 chain, draw // 2, n): halves as chains, the rest flattened."""
    chains, n = draws.shape[:2]
    flat = draws.reshape(chains, n, -1)
    half = n // 2
    return np.concatenate([flat[:, :half], flat[:, n - half :]])


def _normal_scores(draws: np.ndarray) -> np.ndarray:
    from scipy.stats import rankdata  # half a second of import that a Laplace fit never needs

    chains, n, m = draws.shape
    ranks = rankdata(draws.reshape(chains * n, m), axis=0)
    return ndtri((ranks - 0.375) / (chains * n + 0.25)).reshape(chains, n, m)


def _plain_r_hat(draws: np.ndarray) -> np.ndarray:
    n = draws.shape[1]
    within = draws.var(axis=1, ddof=1).mean(axis=0)
    between = n * draws.mean(axis=1).var(axis=0, ddof=1)
    within = np.where(within > 0, within, np.nan)
    return np.sqrt((between / within + n - 1) / n)


def r_hat(draws: np.ndarray) -> np.ndarray:
    """Rank-normalised split R-hat of draws (chain, draw, ...), larger of bulk and folded."""
    halves = _split(draws)
    middle = np.median(halves.reshape(halves.shape[0] * halves.shape[1], -1), axis=0)
    folded = np.abs(halves - middle)
    both = [_plain_r_hat(_normal_scores(part)) for part in (halves, folded)]
    return np.maximum(*both).reshape(draws.shape[2:])


def _ess(draws: np.ndarray) -> np.ndarray:
    """Effective sample size by Geyer's initial monotone sequence, (chain, draw, m) -> (m,).

    Step for step what ArviZ does, the half pair at the end and all: pairs of autocorrelations
    count as long as their sums are positive, the first half of the next one once.
    """
    chains, n, m = draws.shape
    size = 1 << int(2 * n - 1).bit_length()
    centred = draws - draws.mean(axis=1, keepdims=True)
    spectrum = np.fft.rfft(centred, size, axis=1)
    covariance = (np.fft.irfft(spectrum * spectrum.conj(), size, axis=1)[:, :n] / n).mean(axis=0)
    within = covariance[0] * n / (n - 1)
    total = covariance[0]
    if chains > 1:
        total = total + draws.mean(axis=1).var(axis=0, ddof=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        rho = 1 - (within - covariance) / total
    rho[0] = 1.0
    count = max((n - 1) // 2, 1)
    even, pairs = rho[: 2 * count : 2], rho[: 2 * count].reshape(count, 2, m).sum(axis=1)
    last = np.minimum(np.cumprod(pairs > 0, axis=0).sum(axis=0), count - 1)
    falling = np.minimum.accumulate(pairs, axis=0)
    whole = np.where(np.arange(count)[:, None] < last, falling, 0.0).sum(axis=0)
    half, pair = even[last, np.arange(m)], pairs[last, np.arange(m)]
    tau = -1 + 2 * whole + np.where((half > 0) | (pair >= 0), half, 0.0)
    tau = np.maximum(tau, 1 / np.log10(chains * n))
    still = np.ptp(draws, axis=(0, 1)) < 1e-15
    return np.where(still, chains * n, chains * n / tau)


def ess_bulk(draws: np.ndarray) -> np.ndarray:
    """Bulk effective sample size of draws (chain, draw, ...)."""
    return _ess(_normal_scores(_split(draws))).reshape(draws.shape[2:])


def ess_tail(draws: np.ndarray) -> np.ndarray:
    """Tail effective sample size: the smaller of the 5 % and 95 % quantiles' indicators'."""
    halves = _split(draws)
    flat = draws.reshape(draws.shape[0] * draws.shape[1], -1)
    low, high = np.quantile(flat, [0.05, 0.95], axis=0)
    both = [_ess((halves <= low).astype(float)), _ess((halves <= high).astype(float))]
    return np.minimum(*both).reshape(draws.shape[2:])


def parameter_rows(fit: Fitted) -> list[dict[str, Any]]:
    """Rows of parameters.csv."""
    units = getattr(inspect.getmodule(fit.cm.model), "UNITS", {})
    draws = fit.draws()
    sampled = fit.method in ("nuts", "hmc")
    rows = []
    for name in fit.parameter_names:
        value = draws[name]
        flat = value.reshape(*value.shape[:2], -1)
        marks = _marks(fit, name, value.shape[2:])
        for i in range(flat.shape[2]):
            v = flat[:, :, i]
            low, high = np.quantile(v, [0.025, 0.975])
            label = name if flat.shape[2] == 1 else f"{name}[{marks[i]}]"
            row: dict[str, Any] = {"name": label, "mean": v.mean(), "sd": v.std(ddof=1)}
            row |= {"q2.5": low, "q97.5": high, "ess_bulk": None, "ess_tail": None, "r_hat": None}
            if sampled:
                row["ess_bulk"] = float(ess_bulk(v[..., None])[0])
                row["ess_tail"] = float(ess_tail(v[..., None])[0])
                row["r_hat"] = float(r_hat(v[..., None])[0])
            row["unit"] = units.get(name, "")
            rows.append(row)
    return rows


def _marks(fit: Fitted, name: str, shape: tuple[int, ...]) -> list[str]:
    """What tells a site's entries apart: receivers' names and axes where known, else numbers."""
    history = getattr(fit.source, "encounters", fit.source)
    labels = getattr(getattr(history, "receivers", None), "labels", None)
    dims = fit.dims(name)
    if labels is None or dims[:1] != ("receiver",) or shape[0] != len(labels):
        return [str(i) for i in range(int(np.prod(shape)))]
    if len(shape) == 1:
        return list(labels)
    return [f"{label}, {axis}" for label in labels for axis in "xy"[: shape[1]]]


def parameter_text(rows: Sequence[dict[str, Any]]) -> str:
    """Parameters as aligned text."""
    lines = [f"{'':18}{'mean':>10}{'sd':>10}{'2.5 %':>10}{'97.5 %':>10}  unit"]
    for row in rows:
        numbers = "".join(f"{row[c]:>10.4g}" for c in ("mean", "sd", "q2.5", "q97.5"))
        lines.append(f"{row['name']:18}{numbers}  {row['unit']}")
    return "\n".join(lines)
