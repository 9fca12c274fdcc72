"""Plain arrays out of whatever a figure is given: a fit, an InferenceData, a track table."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from maloc.errors import InputError

__all__ = ["Track", "posterior", "track_of"]


class Track(NamedTuple):
    """Posterior positions: means (T, 2) m, covariances (T, 2, 2) m2, times (T,) s, heard (T,)."""

    mean: np.ndarray
    cov: np.ndarray
    time: np.ndarray
    heard: np.ndarray
    mirror: np.ndarray | None = None


def posterior(source: Any) -> dict[str, np.ndarray]:
    """Return draws (chain, draw, ...) of all sites of a fit, an InferenceData or a DataTree.

    Raises
    ------
    InputError
        If `source` is none of these.
    """
    if callable(getattr(source, "draws", None)):
        return {k: np.asarray(v) for k, v in source.draws().items()}
    try:
        group = source["posterior"]
        return {str(k): np.asarray(group[k].values) for k in group.data_vars}
    except (TypeError, KeyError, AttributeError) as problem:
        raise InputError(
            f"cannot plot a {type(source).__name__}",
            mend="give a fit, its to_inference_data(), or the table of track.csv",
        ) from problem


def track_of(source: Any) -> Track:
    """Return the posterior track of a fit, an InferenceData, a DataTree or a track table.

    Parameters
    ----------
    source : Fit, InferenceData, DataTree or DataFrame
        A table has track.csv's columns.

    Raises
    ------
    InputError
        If there is no position in it.
    """
    columns = getattr(source, "columns", None)
    if columns is not None:
        return _from_table(source, [str(c) for c in columns])
    draws = posterior(source)
    if "position" not in draws:
        raise InputError("no 'position' among the posterior's variables", mend="is it a track?")
    position = draws["position"]
    position = position.reshape(-1, *position.shape[-2:])
    mean = position.mean(0)
    centred = position - mean
    cov = np.einsum("nti,ntj->tij", centred, centred) / max(len(position) - 1, 1)
    time = draws.get("emission_time")
    time = np.arange(len(mean), dtype=float) if time is None else time.mean((0, 1))
    return Track(mean, cov, time, np.ones(len(mean), bool))


def _from_table(table: Any, columns: list[str]) -> Track:
    missing = {"x", "y", "sd_x", "sd_y", "cov_xy"} - set(columns)
    if missing:
        raise InputError(f"columns missing in the track table: {', '.join(sorted(missing))}")

    def column(name: str) -> np.ndarray:
        return np.asarray(table[name].to_numpy())

    x, y, sx, sy, c = (column(k).astype(float) for k in ("x", "y", "sd_x", "sd_y", "cov_xy"))
    cov = np.stack([np.stack([sx**2, c], -1), np.stack([c, sy**2], -1)], -1)
    time = column("t").astype(float) if "t" in columns else np.arange(len(x), dtype=float)
    heard = column("heard").astype(bool) if "heard" in columns else np.ones(len(x), bool)
    mirror = None
    if "mirror_x" in columns:
        mirror = np.column_stack([column("mirror_x"), column("mirror_y")]).astype(float)
    return Track(np.column_stack([x, y]), cov, time, heard, mirror)
