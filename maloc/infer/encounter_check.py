"""Who heard the pings, beside who should have: the detection function against the data."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from maloc.data.encounters import EncounterHistory
from maloc.infer.encounter_track import flat_draws
from maloc.infer.result import Fit

__all__ = ["Expected", "expected_hearing"]


class Expected(NamedTuple):
    """What a fit says of who hears a ping, beside what was heard (pings that somebody heard).

    Attributes
    ----------
    distance : array (X,) m
    curve : array (3, X)
        Detection probability: 2.5 %, mean, 97.5 %.
    away, was_heard : array (M,)
        Distance (m) from ping to listening receiver, and whether it heard.
    names : tuple of str
    heard, expected : array (R,)
        Pings that each receiver heard, and is expected to given that somebody did.
    """

    distance: np.ndarray
    curve: np.ndarray
    away: np.ndarray
    was_heard: np.ndarray
    names: tuple[str, ...]
    heard: np.ndarray
    expected: np.ndarray


def expected_hearing(fit: Fit, history: EncounterHistory) -> Expected:
    """Compare who heard the heard pings with what the fit expects (covariates at their mean).

    Parameters
    ----------
    fit : Fit
        Fit of a detection model.
    history : EncounterHistory
        What was fitted.
    """
    from maloc._jax import jnp
    from maloc.detection import log_probabilities

    draws, keep = flat_draws(fit)
    states = np.flatnonzero(np.asarray(fit.args[0].ping)[: fit.n_states])
    rows = history.n_heard > 0
    position, at = draws["position"][keep][:, states[rows]], history.receivers.xy
    if "depth" in draws:  # slant ranges
        deep = draws["depth"][keep][:, states[rows], None]
        position = np.concatenate([position, deep], axis=2)
        at = np.column_stack([at, history.receivers.depth])
    kind = fit.options.get("detection", "halfnormal")
    p0, scale = draws["p0"][keep], draws["scale"][keep]
    shape = draws["shape"][keep] if "shape" in draws else None

    def probability(away, d):
        own = None if shape is None else jnp.asarray(shape[d])
        log_p, _ = log_probabilities(kind, jnp.asarray(away), p0[d], scale[d], own)
        return np.exp(np.asarray(log_p))

    listening = history.listening[rows]
    expected = np.zeros(len(history.receivers))
    for d in range(len(keep)):
        away = np.linalg.norm(position[d][:, None] - at[None], axis=-1)
        p = np.where(listening, probability(away, d), 0.0)
        somebody = -np.expm1(np.log1p(-np.minimum(p, 1 - 1e-12)).sum(axis=1))
        expected += (p / np.maximum(somebody, 1e-12)[:, None]).sum(axis=0) / len(keep)
    away = np.linalg.norm(position.mean(0)[:, None] - at[None], axis=-1)
    top = min(float(away[listening].max()), 5 * float(np.median(scale)))
    distance = np.linspace(0.0, top, 61)
    curves = np.array([probability(distance[None], d)[0] for d in range(len(keep))])
    low, high = np.quantile(curves, [0.025, 0.975], axis=0)
    near = listening & (away <= top)
    return Expected(
        distance,
        np.array([low, curves.mean(axis=0), high]),
        away[near],
        history.heard[rows][near],
        history.receivers.labels,
        history.heard.sum(axis=0),
        expected,
    )
