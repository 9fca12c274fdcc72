"""Convergence diagnostics of Markov chains: rank-normalised split R-hat, bulk and tail ESS.

Vehtari, Gelman, Simpson, Carpenter & Burkner (2021) Rank-normalization, folding, and
localization. Bayesian Analysis 16(2): 667-718. Vectorised over thousands of coordinates, which
ArviZ is not; tests compare the two.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import norm, rankdata

if TYPE_CHECKING:
    from maloc.infer.result import Fit

__all__ = ["ess_bulk", "ess_tail", "parameter_rows", "parameter_text", "r_hat"]


def _split(draws: np.ndarray) -> np.ndarray:
    """(chain, draw, ...) -> (2 chain, draw // 2, n): halves as chains, the rest flattened."""
    chains, n = draws.shape[:2]
    flat = draws.reshape(chains, n, -1)
    half = n // 2
    return np.concatenate([flat[:, :half], flat[:, n - half :]])


def _normal_scores(draws: np.ndarray) -> np.ndarray:
    chains, n, m = draws.shape
    ranks = rankdata(draws.reshape(-1, m), axis=0)
    return norm.ppf((ranks - 0.375) / (chains * n + 0.25)).reshape(chains, n, m)


def _plain_r_hat(draws: np.ndarray) -> np.ndarray:
    n = draws.shape[1]
    within = draws.var(axis=1, ddof=1).mean(axis=0)
    between = n * draws.mean(axis=1).var(axis=0, ddof=1)
    within = np.where(within > 0, within, np.nan)
    return np.sqrt((between / within + n - 1) / n)


def r_hat(draws: np.ndarray) -> np.ndarray:
    """Rank-normalised split R-hat of draws (chain, draw, ...), larger of bulk and folded."""
    halves = _split(draws)
    folded = np.abs(halves - np.median(halves.reshape(-1, halves.shape[-1]), axis=0))
    both = [_plain_r_hat(_normal_scores(part)) for part in (halves, folded)]
    return np.maximum(*both).reshape(draws.shape[2:])


def _ess(draws: np.ndarray) -> np.ndarray:
    """Effective sample size by Geyer's initial monotone sequence, (chain, draw, m) -> (m,)."""
    chains, n, m = draws.shape
    size = 1 << int(2 * n - 1).bit_length()
    centred = draws - draws.mean(axis=1, keepdims=True)
    spectrum = np.fft.rfft(centred, size, axis=1)
    covariance = np.fft.irfft(spectrum * spectrum.conj(), size, axis=1)[:, :n] / n
    mean_covariance = covariance.mean(axis=0)
    within = mean_covariance[0] * n / (n - 1)
    total = within * (n - 1) / n
    if chains > 1:
        total = total + draws.mean(axis=1).var(axis=0, ddof=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        rho = 1 - (within - mean_covariance * n / (n - 1)) / total
    rho[0] = 1.0
    pairs = rho[: n - n % 2].reshape(-1, 2, m).sum(axis=1)
    kept = np.cumprod(pairs > 0, axis=0).astype(bool)
    pairs = np.minimum.accumulate(np.where(kept, pairs, 0.0), axis=0)
    tau = np.maximum(-1 + 2 * pairs.sum(axis=0), 1 / np.log10(chains * n))
    return np.where(total > 0, chains * n / tau, np.nan)


def ess_bulk(draws: np.ndarray) -> np.ndarray:
    """Bulk effective sample size of draws (chain, draw, ...)."""
    return _ess(_normal_scores(_split(draws))).reshape(draws.shape[2:])


def ess_tail(draws: np.ndarray) -> np.ndarray:
    """Tail effective sample size: the smaller of the 5 % and 95 % quantiles' indicators'."""
    halves = _split(draws)
    flat = halves.reshape(-1, halves.shape[-1])
    low, high = np.quantile(flat, [0.05, 0.95], axis=0)
    both = [_ess((halves <= low).astype(float)), _ess((halves <= high).astype(float))]
    return np.fmin(*both).reshape(draws.shape[2:])


def parameter_rows(fit: Fit) -> list[dict[str, Any]]:
    """Rows of parameters.csv."""
    units = getattr(fit.cm.model, "units", {})
    draws = fit.draws()
    path = {s.name for s in fit.cm.chain}
    sampled = fit.method != "laplace"
    rows = []
    for name, value in draws.items():
        if name in path or (value.ndim > 2 and value.shape[2] == fit.n_states):
            continue
        flat = value.reshape(*value.shape[:2], -1)
        for i in range(flat.shape[2]):
            v = flat[:, :, i]
            low, high = np.quantile(v, [0.025, 0.975])
            label = name if flat.shape[2] == 1 else f"{name}[{i}]"
            row: dict[str, Any] = {"name": label, "mean": v.mean(), "sd": v.std(ddof=1)}
            row |= {"q2.5": low, "q97.5": high, "ess_bulk": None, "ess_tail": None, "r_hat": None}
            if sampled:
                row["ess_bulk"] = float(ess_bulk(v[..., None])[0])
                row["ess_tail"] = float(ess_tail(v[..., None])[0])
                row["r_hat"] = float(r_hat(v[..., None])[0])
            row["unit"] = units.get(name, "")
            rows.append(row)
    return rows


def parameter_text(fit: Fit) -> str:
    """Parameters as aligned text."""
    lines = [f"{'':18}{'mean':>10}{'sd':>10}{'2.5 %':>10}{'97.5 %':>10}  unit"]
    for row in parameter_rows(fit):
        numbers = "".join(f"{row[c]:>10.4g}" for c in ("mean", "sd", "q2.5", "q97.5"))
        lines.append(f"{row['name']:18}{numbers}  {row['unit']}")
    return "\n".join(lines)
