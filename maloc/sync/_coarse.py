"""Coarse alignment: offsets of up to a day, drifts of up to a minute a day, and jumps.

Every detection of a sync tag, less its travel time, is an emission time on the receiver's own
clock. A vote over a short window (`_votes`) finds the offset to emission times known from clocks
already aligned; from there it is followed forwards and backwards as long as detections match. Where
they cease to, the clock has jumped, and votes over what is left find its next stretch.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from maloc.sync._progress import Tell, silent
from maloc.sync._votes import DRIFT, pairs, vote

__all__ = ["FEW", "CoarseClock", "Stretch", "align"]

FEW = 6  # fewer detections than this cannot be aligned
BEND = 3e-5  # largest change of drift that is no jump, s/s
KNOWN = 5e-6  # how well the drift of a stretch is known, s/s
NODE = 1800.0  # spacing of the piecewise-linear offset, s
MATCH = 0.3  # emission times this near are of one ping, s
WINDOW = 80  # detections that vote together
CHUNK = 40  # detections by which a stretch grows
SPAN = 4 * 3600.0  # at most this long, s, both
STEP = 0.15  # smaller jumps are left to the joint model, s
CHANCE = 0.02  # share that matches by chance
SHORTEST = 10  # detections that make a stretch after a jump


class Stretch(NamedTuple):
    """Piecewise-linear offset of one receiver between two jumps.

    Attributes
    ----------
    time : array (M,)
        The receiver's own clock, s, ascending.
    offset : array (M,)
        Own clock minus the common one, s.
    drift : float
        Slope used beyond the ends, s/s.
    rows : array of int
        Its detections, ascending in own time.
    """

    time: np.ndarray
    offset: np.ndarray
    drift: float
    rows: np.ndarray

    def at(self, time: np.ndarray) -> np.ndarray:
        """Offset (N,) at times (N,) of the receiver's own clock, s."""
        inside = np.clip(time, self.time[0], self.time[-1])
        return np.interp(inside, self.time, self.offset) + self.drift * (time - inside)

    @property
    def common(self) -> np.ndarray:
        """Common time (M,) of the nodes, s."""
        return self.time - self.offset


class CoarseClock(NamedTuple):
    """One receiver's clock: its stretches in time order.

    Attributes
    ----------
    stretches : tuple of Stretch
    ambiguous : bool
        Another offset had nearly as many votes (sync tags with one common, regular interval).
    """

    stretches: tuple[Stretch, ...]
    ambiguous: bool = False

    @property
    def jumps(self) -> list[tuple[float, float]]:
        """Common time and size of each jump, s."""
        out = []
        for a, b in zip(self.stretches[:-1], self.stretches[1:], strict=True):
            middle = 0.5 * (a.common[-1] + b.common[0])
            before, after = (float(s.at(middle + s.offset[[i]])[0]) for s, i in ((a, -1), (b, 0)))
            out.append((float(middle), after - before))
        return out

    @property
    def jump(self) -> float:
        """Largest jump, s; 0 = none."""
        return max((size for _, size in self.jumps), key=abs, default=0.0)

    def at(self, time: np.ndarray) -> np.ndarray:
        """Offset (N,) at own times (N,), by the stretch nearest in own time, s."""
        away = [np.maximum(s.time[0] - time, time - s.time[-1]) for s in self.stretches]
        nearest, out = np.argmin(away, axis=0), np.zeros(len(time))
        for i, s in enumerate(self.stretches):
            out[nearest == i] = s.at(time[nearest == i])
        return out


def align(
    emission: np.ndarray,
    tag: np.ndarray,
    receiver: np.ndarray,
    n_receivers: int,
    reference: int,
    *,
    limit: float = 26 * 3600.0,
    tell: Tell = silent,
) -> dict[int, CoarseClock]:
    """Align all receivers to one, those that share most with the aligned ones first.

    Parameters
    ----------
    emission : array (N,)
        Recorded time less travel time from the sync tag, on the receiver's own clock, s.
    tag, receiver : array (N,) of int
    n_receivers, reference : int
    limit : float
        Largest offset searched for, s.
    tell : Tell
        Told of each receiver that is tried.

    Returns
    -------
    dict of int to CoarseClock
        Receivers that could be aligned (the reference among them, offset 0).
    """
    room = 2 * (np.ptp(emission) + 2 * limit + 10.0) if len(emission) else 1.0
    base = emission.min() - limit - 5.0 if len(emission) else 0.0
    key = tag * room + (emission - base)  # one sorted axis on which tags never meet
    rows = [np.flatnonzero(receiver == j) for j in range(n_receivers)]
    rows = [i[np.argsort(emission[i], kind="stable")] for i in rows]
    heard = np.zeros((n_receivers, int(tag.max(initial=0)) + 1))
    np.add.at(heard, (receiver, tag), 1)
    shared = np.minimum(heard[:, None], heard[None]).sum(2)

    zero = np.zeros(1)
    clocks = {reference: CoarseClock((Stretch(zero, zero, 0.0, rows[reference]),))}
    known = np.sort(key[rows[reference]])
    todo = [j for j in range(n_receivers) if j != reference and len(rows[j]) >= FEW]
    while todo and len(known) > 1:
        order = sorted(todo, key=lambda j: (-max(shared[j, k] for k in clocks), j))
        for j in order:
            tell("aligning clocks")
            clock = _align_one(emission[rows[j]], key[rows[j]], known, limit)
            if clock is not None:
                break
        else:
            break
        stretches = tuple(s._replace(rows=rows[j][s.rows]) for s in clock.stretches)
        clocks[j] = clock._replace(stretches=stretches)
        todo.remove(j)
        for s in stretches:
            known = _merge(known, key[s.rows] - s.at(emission[s.rows]))
    return clocks


def _align_one(
    time: np.ndarray, key: np.ndarray, known: np.ndarray, limit: float
) -> CoarseClock | None:
    """Stretches of one clock; `rows` index its own detections."""
    left = np.ones(len(time), bool)
    found: list[tuple[np.ndarray, np.ndarray]] = []
    windows, ambiguous, share = _windows(time), False, 0.0
    first = [windows[i] for i in np.unique(np.linspace(0, len(windows) - 1, 16).astype(int))]
    for n, window in enumerate([*first, *windows]):
        if n == len(first) and not found:
            return None  # windows all over the record found nothing
        rows = window[left[window]]
        if len(rows) < FEW - 1 or (found and len(rows) < len(window) * (1 - 0.5 * share)):
            continue
        best = vote(time[rows], key[rows], known, limit)
        if best is None or (found and best.ambiguous):
            continue
        rows, offset = _follow(time, key, known, left, rows, best.offset)
        if len(rows) < (SHORTEST if found else FEW - 1):
            continue
        left[rows] = False
        found.append((rows, offset))
        ambiguous |= best.ambiguous
        share = max(share, len(rows) / (rows[-1] - rows[0] + 1))
    if not found:
        return None
    return CoarseClock(tuple(_complete(_in_order(found, time), time)), ambiguous)


def _windows(time: np.ndarray) -> list[np.ndarray]:
    """Row indices of windows that cover a sorted record."""
    cut = [0]
    while cut[-1] < len(time):
        end = np.searchsorted(time, time[cut[-1]] + SPAN, "right")
        # sparse records: fewer than enough to vote in the longest span
        cut.append(int(min(max(end, cut[-1] + 3 * FEW), cut[-1] + WINDOW, len(time))))
    if len(cut) > 2 and cut[-1] - cut[-2] < 2 * FEW:
        del cut[-2]
    return [np.arange(a, b) for a, b in zip(cut[:-1], cut[1:], strict=True)]


def _nearest(key: np.ndarray, known: np.ndarray) -> np.ndarray:
    """How far each emission time (N,) is from the nearest known one, s."""
    right = np.clip(np.searchsorted(known, key), 1, len(known) - 1)
    after, before = key - known[right], key - known[right - 1]
    return np.where(np.abs(after) < np.abs(before), after, before)


def _line(
    time: np.ndarray, key: np.ndarray, known: np.ndarray, offset: float
) -> tuple[float, float, float]:
    """Offset at the middle of a window, drift, and middle, by votes on both."""
    middle = float(np.median(time))
    reach = 0.3 + DRIFT * float(np.ptp(time))
    low = np.searchsorted(known, key - offset - reach)
    high = np.searchsorted(known, key - offset + reach)
    i, j = pairs(low, high)
    rest, x = key[i] - known[j] - offset, time[i] - middle
    steps = max(1, int(np.ceil(DRIFT * np.ptp(time) / 2 / 0.2)))
    best = (0, 0.0, 0.0)
    for drift in DRIFT * np.arange(-steps, steps + 1) / steps:
        value = np.sort(rest - drift * x)
        count = np.searchsorted(value, value + 0.3, "right") - np.arange(len(value))
        n = int(count.argmax())
        if count[n] > best[0]:
            best = (int(count[n]), float(np.median(value[n : n + count[n]])), float(drift))
    _, level, drift = best
    near = np.abs(rest - level - drift * x) < 0.25
    if near.sum() > 8 and np.ptp(x[near]) > 600:
        half = np.median(x[near])
        a, b = near & (x <= half), near & (x > half)
        if a.any() and b.any():
            run = np.median(x[b]) - np.median(x[a])
            drift = float((np.median(rest[b]) - np.median(rest[a])) / run) if run > 0 else drift
            level = float(np.median(rest[near] - drift * x[near]))
    return offset + level, drift, middle


def _follow(
    time: np.ndarray,
    key: np.ndarray,
    known: np.ndarray,
    left: np.ndarray,
    window: np.ndarray,
    offset: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Rows, and the offset of each, of the stretch that a vote belongs to: followed both ways."""
    level, drift, middle = _line(time[window], key[window], known, offset)
    line = level + drift * (time[window] - middle)
    rest = _nearest(key[window] - line, known)
    match = np.abs(rest) < MATCH
    if match.sum() < 4:
        return window[:0], line[:0]
    seed, values = window[match], (line + rest)[match]
    share, found = float(match.mean()), [(seed, values)]
    start = float(np.median(time[seed]))
    for way in (1, -1):
        # nodes of what was followed so far: time, offset
        nodes = [(start, float(np.median(values - drift * (time[seed] - start))))]
        slope, misses, at, last = drift, 0, 0, time[seed[-1 if way > 0 else 0]]
        rows = np.flatnonzero(left)
        rows = rows[rows > seed[-1]] if way > 0 else rows[rows < seed[0]][::-1]
        while at < len(rows) and misses < 3:
            near = np.abs(time[rows[at : at + CHUNK]] - time[rows[at]]) <= SPAN
            chunk = rows[at : at + int(near.sum())]
            at += len(chunk)
            line = nodes[-1][1] + slope * (time[chunk] - nodes[-1][0])
            rest = _nearest(key[chunk] - line, known)
            # what a silence hides may bend; what was heard and did not match has jumped
            silence = abs(time[chunk[0]] - last)
            away, last = abs(time[chunk[-1]] - nodes[-1][0]), time[chunk[-1]]
            ok = np.abs(rest) < MATCH + min(BEND * silence + KNOWN * away, 0.7)
            ok &= _before_the_end(ok, share)
            found.append((chunk[ok], (line + rest)[ok]))
            if ok.sum() < max(2.0, 0.4 * share * len(chunk)):
                misses += 1
                continue
            misses = 0
            t = float(np.median(time[chunk[ok]]))
            nodes.append((t, float(np.median((line + rest)[ok] - slope * (time[chunk[ok]] - t)))))
            x, y = np.array([p for p in nodes if abs(p[0] - t) < 3 * 3600][-40:] or nodes[-2:]).T
            if len(x) > 1 and np.ptp(x) > 1200:
                fitted = np.polyfit(x - t, y, 1)[0]
                slope = float(np.clip(fitted, -1.2 * DRIFT, 1.2 * DRIFT))
    all_rows, all_values = (np.concatenate(part) for part in zip(*found, strict=True))
    order = np.argsort(all_rows)
    return all_rows[order], all_values[order]


def _before_the_end(ok: np.ndarray, share: float) -> np.ndarray:
    """Which of a row of detections (N,) lie before matches cease, if they do."""
    share = min(share, 0.95)
    score = np.cumsum(np.where(ok, np.log(share / CHANCE), np.log((1 - share) / (1 - CHANCE))))
    if len(score) == 0 or score.max() <= 0:
        return np.zeros(len(ok), bool)
    return np.arange(len(ok)) <= int(len(ok) - 1 - score[::-1].argmax())


def _stretch(time: np.ndarray, rows: np.ndarray, value: np.ndarray) -> Stretch:
    """Piecewise-linear offset of one stretch: medians in pieces of `NODE` seconds."""
    t = time[rows]
    line = np.polyfit(t - t[0], value, 1) if np.ptp(t) > 600 else [0.0, np.median(value)]
    flat = value - np.polyval(line, t - t[0])
    bins = ((t - t[0]) / NODE).astype(int)
    cut = np.r_[0, np.flatnonzero(np.diff(bins)) + 1, len(t)]
    parts = [(a, b) for a, b in zip(cut[:-1], cut[1:], strict=True) if b - a >= 5]
    parts = parts or [(0, len(t))]
    x = np.array([t[a:b].mean() for a, b in parts])
    y = np.array([np.median(flat[a:b]) for a, b in parts]) + np.polyval(line, x - t[0])
    slope = np.median(np.diff(y) / np.maximum(np.diff(x), 1.0)) if len(x) > 2 else line[0]
    return Stretch(x, y, float(slope), rows)


def _in_order(found: list[tuple[np.ndarray, np.ndarray]], time: np.ndarray) -> list[Stretch]:
    """Stretches in common time; those that contradict a longer one are dropped, silences joined."""
    kept: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    for rows, value in sorted(found, key=lambda f: -len(f[0])):
        common = time[rows] - value
        within = [(common > c[0]) & (common < c[-1]) for *_, c in kept]
        if not kept or np.any(within, axis=0).mean() < 0.5:
            kept.append((rows, value, np.sort(common)))
    kept.sort(key=lambda f: f[2][0])
    out: list[tuple[np.ndarray, np.ndarray, Stretch]] = []
    for rows, value, _ in kept:
        stretch = _stretch(time, rows, value)
        if out:
            _, size = CoarseClock((out[-1][2], stretch)).jumps[0]
            silence = float(stretch.common[0] - out[-1][2].common[-1])
            if abs(size) < STEP + 1e-5 * max(silence, 0.0):
                before, values, _ = out.pop()
                rows, value = np.r_[before, rows], np.r_[values, value]
                order = np.argsort(rows)
                rows, value = rows[order], value[order]
                stretch = _stretch(time, rows, value)
        out.append((rows, value, stretch))
    return [stretch for *_, stretch in out]


def _complete(stretches: list[Stretch], time: np.ndarray) -> list[Stretch]:
    """Add detections that matched nothing but lie, on their own clock, in one stretch only."""
    taken, inside = np.zeros(len(time), bool), np.zeros((len(stretches), len(time)), bool)
    for i, s in enumerate(stretches):
        taken[s.rows] = True
        inside[i] = (time >= time[s.rows[0]]) & (time <= time[s.rows[-1]])
    if len(stretches) == 1:
        inside[:] = True
    single = ~taken & (inside.sum(0) == 1)
    return [
        s._replace(rows=np.sort(np.r_[s.rows, np.flatnonzero(single & inside[i])]))
        for i, s in enumerate(stretches)
    ]


def _merge(known: np.ndarray, key: np.ndarray, within: float = 1.0) -> np.ndarray:
    """Add emission times that are not known yet."""
    away = np.abs(_nearest(key, known))
    new = np.sort(key[away > within])
    if len(new):
        new = new[np.r_[True, np.diff(new) > within]]
    return np.sort(np.concatenate([known, new]))
