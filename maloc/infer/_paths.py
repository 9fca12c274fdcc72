"""From the flat draws of a fit to one tag's path: its states, clock, law and parameters."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

import numpy as np

from maloc._jax import jax
from maloc.errors import FitError, InputError
from maloc.infer._bridge import PathDraws
from maloc.infer._depths import DepthDraws
from maloc.infer._model import ChainModel, _unwrap
from maloc.model_data.encounters import EncounterData
from maloc.model_data.joint import JointData
from maloc.model_data.toa import ToaData
from maloc.movement import OU
from maloc.movement.path import MarkovPath
from maloc.world.depth import DepthPath

if TYPE_CHECKING:
    from maloc.infer._fit import Fitted

__all__ = ["in_order", "path_draws", "path_of", "path_site", "read_law", "states_of"]


def path_draws(
    fit: Fitted, tag: int = 0, n: int | None = None, seed: int | None = None
) -> PathDraws:
    """Draws of a tag's path, with the clock and the parameters of its movement.

    Raises
    ------
    FitError
        If the fit has no path that moves in continuous time.
    InputError
        If there is no such tag.
    """
    x, u = fit.flat_draws(n, seed)
    x, u = x.reshape(-1, *x.shape[2:]), u.reshape(x.shape[0] * x.shape[1], -1)
    return path_of(fit, x, u, tag)


def path_site(cm: ChainModel):
    """The site of the path that moves in continuous time."""
    found = [s for s in cm.chain if issubclass(s.law, MarkovPath) and s.law is not DepthPath]
    if len(found) != 1:
        raise FitError("prediction needs one path of maloc.movement: CTCRW, Brownian or OU")
    return found[0]


def path_of(fit: Fitted, x: np.ndarray, u: np.ndarray, tag: int) -> PathDraws:
    """Paths of one tag in flat draws x (D, T, d), u (D, k)."""
    site = path_site(fit.cm)
    read = read_law(fit, x, u)
    mine = states_of(fit, read.get("tag"), tag)
    told, time = clock_parts(fit, read)
    clock = np.tile(time[mine], (len(x), 1))
    if told.any():
        clock = np.where(told[mine], read["emission_time"][:, mine], clock)
    state = x[:, mine, site.columns].reshape(len(x), len(mine), -1, site.tail[-1])
    scale = {k: by_tag(read[k], mine[:1])[:, 0] for k in site.law.scale_names}
    home = by_tag(read["centre"], mine[:1], True)[:, 0] if "centre" in read else None
    clock = in_order(clock)
    depth = _depths(fit, x, read, mine, clock)
    return PathDraws(site.law, scale, clock, state, home, fit.water, depth)


def _depths(fit: Fitted, x: np.ndarray, read: dict, mine: np.ndarray, clock: np.ndarray):
    """Depths of one tag (states `mine`) in flat draws x (D, T, d), or None."""
    water = getattr(fit.args[0], "depth", None) if fit.args else None
    if water is None:
        return None
    known, path = np.asarray(water.observed)[mine], None
    for site in fit.cm.chain:
        if site.law is DepthPath:
            state = x[:, mine, site.columns].reshape(len(x), len(mine), 1, 1)
            scale = {k: by_tag(read[f"depth_{k}"], mine[:1])[:, 0] for k in DepthPath.scale_names}
            home = by_tag(read["depth_centre"], mine[:1], True)[:, 0]
            path = PathDraws(OU, scale, clock, state, home)
    return DepthDraws(path, water, np.median(clock, axis=0), known)


def read_law(fit: Fitted, x: np.ndarray, u: np.ndarray, emission: bool = True) -> dict:
    """What the path's law is made of, for flat draws x (D, T, d), u (D, k); padding too.

    ``dt`` (T - 1,) and ``tag`` (T,) are data; the law's parameters, ``centre`` where it has a home
    and ``emission_time`` have one value a draw (the last the first draw's alone, if ``emission`` is
    false). One draw at a time: any number of them shares one compilation.
    """
    read = _reader(fit.cm, path_site(fit.cm).name)
    once = {"dt", "tag"} | (set() if emission else {"emission_time"})
    out: dict[str, list] = {}
    for one_x, one_u in zip(x, u, strict=True):
        for name, value in read(one_x, one_u, fit.args).items():
            if name not in once or name not in out:
                out.setdefault(name, []).append(np.asarray(value))
    return {k: v[0] if k in ("dt", "tag") else np.array(v) for k, v in out.items()}


def by_tag(value: np.ndarray, first: np.ndarray, vector: bool = False) -> np.ndarray:
    """A parameter (D,) or (D, T), or vectors of them, at the tags' first states: (D, N, ...)."""
    if value.ndim == 1 + vector:
        return np.repeat(value[:, None], len(first), axis=1)
    return value[:, first]


@functools.lru_cache(maxsize=32)
def _reader(cm: ChainModel, name: str):
    """Jitted: what the path's law and the clock are made of, for one draw x (T, d), u (k,)."""

    def one(x, u, args):
        trace = cm._trace(cm.sites(x, u)[0], args)
        law, _ = _unwrap(trace[name]["fn"])
        out = {key: getattr(law, key) for key in law.scale_names}
        if isinstance(law, OU):
            out["centre"] = law.centre
        if "depth_path" in trace:
            deep, _ = _unwrap(trace["depth_path"]["fn"])
            names = (*deep.scale_names, "centre")
            out |= {f"depth_{key}": getattr(deep, key) for key in names}
        if law.tag is not None:
            out["tag"] = law.tag
        if "emission_time" in trace:
            out["emission_time"] = trace["emission_time"]["value"]
        out["dt"] = law.dt
        return out

    return jax.jit(one)


def states_of(fit: Fitted, tags: np.ndarray | None, tag: int) -> np.ndarray:
    """Indices of a tag's states."""
    here = np.zeros(fit.n_states, int) if tags is None else tags[: fit.n_states]
    mine = np.flatnonzero(here == tag)
    if not len(mine):
        raise InputError(f"there is no tag {tag}: the fit has {len(np.unique(here))}")
    return mine


def clock_parts(fit: Fitted, read: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Where a state stands at its emission time (T,) bool, and its time elsewhere (T,), s.

    In a model of somebody's own all tags begin at 0.
    """
    data, n = fit.args[0] if fit.args else None, fit.n_states
    if isinstance(data, ToaData | EncounterData | JointData):
        told = np.zeros(n, bool)
        if "emission_time" in read:
            told = emission_told(data)[:n] if isinstance(data, JointData) else ~told
        return told, np.asarray(data.time)[:n]
    clock = np.concatenate([[0.0], np.cumsum(read["dt"][: n - 1])])
    if "tag" in read:
        tag = read["tag"][:n]
        starts = np.concatenate([[True], tag[1:] != tag[:-1]])
        clock = clock - clock[np.maximum.accumulate(np.where(starts, np.arange(n), 0))]
    return np.zeros(n, bool), clock


def in_order(clock: np.ndarray) -> np.ndarray:
    """Times of states (D, T), s, made to ascend strictly."""
    least = 1e-6 * np.arange(clock.shape[1])  # states at one instant stay in order
    return np.maximum.accumulate(clock - least, axis=1) + least


def emission_told(data: JointData) -> np.ndarray:
    """Where the emission time of a state is told by arrivals or by a beat, (S,) bool."""
    heard = np.asarray(data.heard).any(axis=1)
    return heard | (np.asarray(data.ping) & (data.schedule in ("stable", "sequence")))
