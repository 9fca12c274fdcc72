"""Posterior predictive checks of what a fit was given; each names the input that it suspects."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from maloc._jax import jax
from maloc.errors import InputError, MalocWarning
from maloc.infer import _array_checks as array_checks
from maloc.infer import _schedule_checks as schedule_checks
from maloc.infer._input_scores import Point, fitted_point
from maloc.infer.result import Fit

__all__ = ["InputCheck", "InputChecks", "check_inputs"]

LEVEL = 0.01


@dataclass(frozen=True)
class InputCheck:
    """One check.

    Attributes
    ----------
    name : str
        What was checked: "burst limits", "stable interval", "receiver positions", "sound speed".
    statistic, threshold : float
        Suspect where the statistic reaches the threshold; NaN where nothing was checked.
    p : float
        Chance of as large a statistic where the input is right.
    finding : str
        What the data say of the input.
    suspect : str
        The input that looks wrong and how; empty where none does.
    receiver : str
        The receiver that stands out most, where one does.
    estimate : tuple of float
        Its displacement, east and north (m): it stands so far from where it was said to; or by
        which share the sound speed is higher than was given.
    """

    name: str
    statistic: float
    threshold: float
    p: float
    finding: str
    suspect: str = ""
    receiver: str = ""
    estimate: tuple[float, ...] = ()


@dataclass(frozen=True)
class InputChecks:
    """What `check_inputs` found.

    Attributes
    ----------
    rows : tuple of InputCheck
    """

    rows: tuple[InputCheck, ...]

    @property
    def suspects(self) -> tuple[str, ...]:
        """What looks wrong, a sentence each; empty where nothing does."""
        return tuple(row.suspect for row in self.rows if row.suspect)

    def __getitem__(self, name: str) -> InputCheck:
        """The check of that name."""
        return next(row for row in self.rows if row.name == name)

    def __str__(self) -> str:
        head = f"{'check':20}{'statistic':>10}{'threshold':>10}{'p':>9}     finding"
        lines = [head]
        for row in self.rows:
            numbers = "".join(
                f"{'-' if np.isnan(v) else format(v, '.3g'):>10}"
                for v in (row.statistic, row.threshold)
            )
            p = "-" if np.isnan(row.p) else "< .0001" if row.p < 1e-4 else f"{row.p:.4f}"
            mark = " !" if row.suspect else "  "
            lines.append(f"{row.name:20}{numbers}{p:>9}  {mark} {row.finding}")
        return "\n".join(lines)


def check_inputs(
    fit: Fit, toa: Any, *, pool: Sequence[Fit] = (), simulations: int = 49, seed: int = 0
) -> InputChecks:
    """Check burst limits, receiver positions and sound speed against what was fitted with them.

    Parameters
    ----------
    fit : Fit
        Fit of a model of arrival times (`maloc.models.toa_track`, `maloc.models.joint`); of a
        sampled one the posterior mean counts.
    toa : ArrivalTimes or ArrivalHistory
        What was fitted.
    pool : sequence of Fit
        Fits of other tracks in the same array: receiver positions and sound speed are judged by
        all of them together.
    simulations : int
        Data sets simulated from each fit, from which the thresholds of receiver positions and
        sound speed are taken; at least 10.
    seed : int
        Seed of the simulations.

    Returns
    -------
    InputChecks
        A row a check. What looks wrong is warned of as well.

    Raises
    ------
    InputError
        If the model has no arrival times, the fits are not of one array, or there are too few
        simulations.

    Notes
    -----
    A wrong sound speed moves the scores of all receivers, and a receiver in a wrong place that of
    the sound speed; of the two the one that the data speak most against is named, and the other
    is judged with that one free. Mend it, fit again and check again.

    References
    ----------
    Efficient scores: Cox & Hinkley (1974) Theoretical Statistics, 9.3. Posterior predictive checks:
    Gelman, Meng & Stern (1996) Statistica Sinica 6: 733-807.
    """
    if simulations < 10:
        raise InputError(f"{simulations} simulations are too few", mend="give 10 or more")
    fits = (fit, *pool)
    points = [fitted_point(f) for f in fits if _has_arrivals(f)]
    names = _names(toa)
    for point in points:
        _refuse_other_array(point, points[0], len(names))
    rows = [*_schedule(points[0], seed), *_array(points, names, simulations, seed)]
    found = InputChecks(tuple(rows))
    for suspect in found.suspects:
        warnings.warn(suspect, MalocWarning, stacklevel=2)
    return found


def _has_arrivals(fit: Fit) -> bool:
    data = fit.args[0] if fit.args else None
    sites = {site.name for site in fit.cm.chain}
    if not hasattr(data, "range") or "emission" not in sites:
        raise InputError(f"a fit of {fit.model_name} has no arrival times to check inputs by")
    return True


def _names(toa: Any) -> tuple[str, ...]:
    receivers = getattr(toa, "receivers", None)
    return (toa.encounters.receivers if receivers is None else receivers).labels


def _refuse_other_array(point: Point, first: Point, n_names: int) -> None:
    xy = [np.asarray(p.args[0].receiver_xy)[np.asarray(p.args[0].present)] for p in (point, first)]
    if xy[0].shape != xy[1].shape or not np.allclose(xy[0], xy[1]):
        raise InputError("pooled fits are not of one table of receivers")
    if len(xy[0]) != n_names:
        raise InputError(f"{n_names} receivers in the arrival times, {len(xy[0])} in the fit")


def _schedule(point: Point, seed: int) -> list[InputCheck]:
    data = point.args[0]
    if data.schedule not in ("random", "stable") or np.asarray(data.valid).sum() < 3:
        return []
    rng = np.random.default_rng(seed)
    gaps = schedule_checks.implied_gaps(point, rng)
    lo, hi = (float(v) for v in data.interval)
    if data.schedule == "random":
        found = schedule_checks.outside_limits(gaps, lo, hi, LEVEL, rng)
        count, total = int(found.gaps.sum()), len(gaps.length)
        text = f"{count} of {total} gaps are outside {lo:g}-{hi:g} s by more than .25 s"
        bad = count >= found.threshold
        suspect = f"burst limits: {text}: limits too narrow" if bad else ""
        return [InputCheck("burst limits", count, found.threshold, found.p, text, suspect)]
    found = schedule_checks.spread_of_intervals(gaps, lo, hi, LEVEL, rng)
    text = f"intervals vary by {found.sd:.2g} s about {lo:g} s"
    bad = found.sd >= found.threshold
    suspect = f"burst interval: {text}: not a stable interval" if bad else ""
    return [InputCheck("stable interval", found.sd, found.threshold, found.p, text, suspect)]


def _array(
    points: list[Point], names: tuple[str, ...], simulations: int, seed: int
) -> list[InputCheck]:
    both = array_checks.scored(points, jax.random.key(seed), simulations)
    estimated = [p for p in points if any("sound_speed" in g.name for g in p.cm.globals)]
    if estimated:
        sd = float(np.mean([p.args[0].speed_sd for p in estimated]))
        at = _receivers([array_checks.without(a, a.inward, 1 / sd**2) for a in both])
        note = "estimated by the model, not given"
        speed_row = InputCheck("sound speed", np.nan, np.nan, np.nan, note)
        return [speed_row, _receiver_row(at, names)]
    at = _receivers(both)
    speed = array_checks.judge_speed(both[0], LEVEL)
    if min(speed.p, at.p) >= LEVEL:
        return [_speed_row(speed), _receiver_row(at, names)]
    if _weight(speed) > _weight(at):
        rest = _receivers([array_checks.without(a, a.inward, 0.0) for a in both])
        return [_speed_row(speed), _receiver_row(rest, names, "the sound speed")]
    rest = both[0]
    for axis in np.eye(2):
        direction = np.zeros_like(rest.score)
        direction[at.which] = axis
        rest = array_checks.without(rest, direction, 0.0)
    other = _speed_row(array_checks.judge_speed(rest, LEVEL), names[at.which])
    return [other, _receiver_row(at, names)]


def _receivers(both: Sequence[array_checks.Array]) -> array_checks.Verdict:
    """The more striking of two looks, each at half the level."""
    found = [array_checks.judge_receivers(array, LEVEL / len(both)) for array in both]
    least = min(found, key=lambda verdict: verdict.p)
    return least._replace(p=min(1.0, len(both) * least.p))


def _weight(verdict: array_checks.Verdict) -> float:
    """How much the data speak against it, on a scale that p values fall off."""
    return verdict.statistic / verdict.threshold


def _speed_row(found: array_checks.Verdict, free: str = "") -> InputCheck:
    high = -100 * float(found.estimate)
    text = f"about {abs(high):.2g} % too {'high' if high > 0 else 'low'} (sd {100 * found.sd:.2g})"
    bad = found.statistic >= found.threshold and not free
    suspect = f"sound speed: {text}" if bad else ""
    text += f", with {free} free" if free else ""
    return InputCheck("sound speed", *found[:3], text, suspect, estimate=(float(found.estimate),))


def _receiver_row(
    found: array_checks.Verdict, names: tuple[str, ...], free: str = ""
) -> InputCheck:
    east, north = found.estimate
    text = (
        f"{names[found.which]} stands {np.hypot(east, north):.2g} m from where it is said to: "
        f"{east:+.1f} m east, {north:+.1f} m north (sd {found.sd[0]:.1f}, {found.sd[1]:.1f})"
    )
    bad = found.statistic >= found.threshold and not free
    suspect = f"receiver positions: {text}" if bad else ""
    text += f", with {free} free" if free else ""
    shift = (float(east), float(north))
    return InputCheck("receiver positions", *found[:3], text, suspect, names[found.which], shift)
