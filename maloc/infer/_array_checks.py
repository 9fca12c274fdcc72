"""Whether each receiver stands where the table says, and the sound speed is what was given."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import stats

from maloc._jax import jax
from maloc.infer import _input_scores as scores

__all__ = ["Array", "Verdict", "judge_receivers", "judge_speed", "scored", "without"]

_SHIFT_SD = 30.0  # m; displacements that are looked for
_TEMPERS = 0.0, _SHIFT_SD / 3  # m; least errors that receivers are looked at through


class Array(NamedTuple):
    """Scores of the receivers' positions, those of S simulations, their information.

    score : (R, 2) 1/m; simulated : (S, R, 2); information : (R, 2, R, 2) 1/m^2; inward : (R, 2) m,
    the displacement that looks like a sound speed too low by all of it.
    """

    score: np.ndarray
    simulated: np.ndarray
    information: np.ndarray
    inward: np.ndarray


class Verdict(NamedTuple):
    """Statistic, its threshold, p; which receiver; estimate and its sd, (m, m) or relative."""

    statistic: float
    threshold: float
    p: float
    which: int
    estimate: np.ndarray
    sd: np.ndarray


def scored(points: list[scores.Point], key, simulations: int) -> tuple[Array, Array]:
    """Scores of several fits in one array, added up: as fitted, and with errors widened."""
    data = points[0].args[0]
    present = np.asarray(data.present)
    xy = np.asarray(data.receiver_xy)[present]
    shape = (len(_TEMPERS), len(xy), 2)
    score, information = np.zeros(shape), np.zeros((*shape, *shape[1:]))
    simulated = np.zeros((simulations, *shape))

    def seen(point, lenses):
        return np.array([scores.score(point, each)[present] for each in lenses])

    for point, key_point in zip(points, jax.random.split(key, len(points)), strict=True):
        lenses = [scores.lens(point, temper) for temper in _TEMPERS]
        score += seen(point, lenses)
        for total, each in zip(information, lenses, strict=True):
            total += each.information[present][:, :, present]
        for i, key_draw in enumerate(jax.random.split(key_point, simulations)):
            again = scores.refitted(point, scores.redrawn(point, key_draw))
            simulated[i] += seen(again, lenses)
    inward = xy.mean(axis=0) - xy
    sharp, wide = (
        Array(score[i], simulated[:, i], information[i], inward) for i in range(len(_TEMPERS))
    )
    return sharp, wide


def without(array: Array, direction: np.ndarray, precision: float) -> Array:
    """The same when displacement along `direction` (R, 2) is estimated too, its prior known."""
    taken = np.einsum("iajb,jb->ia", array.information, direction)
    size = np.sum(direction * taken) + precision
    along = np.einsum("ia,...ia->...", direction, array.simulated)
    return Array(
        array.score - taken * np.sum(direction * array.score) / size,
        array.simulated - along[:, None, None] * taken / size,
        array.information - taken[:, :, None, None] * taken / size,
        array.inward,
    )


def judge_speed(array: Array, level: float) -> Verdict:
    """Two-sided; the simulations give the score's mean and sd."""
    size = float(np.einsum("ia,iajb,jb->", array.inward, array.information, array.inward))
    size = max(size, 1e-12)
    z = np.sum(array.inward * array.score) / np.sqrt(size)
    drawn = np.einsum("ia,sia->s", array.inward, array.simulated) / np.sqrt(size)
    freedom = len(drawn) - 1
    width = max(float(drawn.std(ddof=1)), 1e-12) * np.sqrt(1 + 1 / len(drawn))
    t = (z - drawn.mean()) / width
    p = 2 * float(stats.t.sf(abs(t), freedom))
    threshold = float(stats.t.isf(level / 2, freedom))
    estimate, sd = (z - drawn.mean()) / np.sqrt(size), width / np.sqrt(size)
    return Verdict(abs(t), threshold, p, -1, np.asarray(estimate), np.asarray(sd))


def judge_receivers(array: Array, level: float) -> Verdict:
    """The largest squared score, each receiver's in units of its mean in the simulations.

    Of a receiver that is well seen it is half a chi-square of 2 degrees of freedom over such a
    mean: F of 2 and twice as many as there are simulations.
    """
    own = array.information[np.arange(len(array.score)), :, np.arange(len(array.score))]
    covariance = np.linalg.inv(own + np.eye(2) / _SHIFT_SD**2)
    squared = np.einsum("ia,iab,ib->i", array.score, covariance, array.score)
    drawn = np.einsum("sia,iab,sib->si", array.simulated, covariance, array.simulated)
    mean = drawn.mean(axis=0)
    seen = mean > 1e-9
    ratio = np.where(seen, squared / np.where(seen, mean, 1.0), 0.0)
    law = stats.f(2, 2 * len(drawn))
    which = int(np.argmax(ratio))
    p = float(-np.expm1(seen.sum() * np.log1p(-min(law.sf(ratio[which]), 1 - 1e-12))))
    each = -np.expm1(np.log1p(-level) / max(seen.sum(), 1))
    return Verdict(
        float(ratio[which]),
        float(law.isf(each)),
        p,
        which,
        covariance[which] @ array.score[which],
        np.sqrt(np.diagonal(covariance[which]) * max(mean[which] / 2, 1e-12)),
    )
