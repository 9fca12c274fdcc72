"""Tags: whose they are, what their sensors measure, and how often they ping."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from maloc.data import _arrays
from maloc.data._codespaces import canonical
from maloc.data.report import Note, ReadReport
from maloc.errors import InputError

if TYPE_CHECKING:
    from maloc.data.detections import Detections
    from maloc.data.receivers import Receivers

__all__ = ["Tags", "sensor_values"]

UNITS = {
    "depth": ("m", "meter", "meters", "metre", "metres"),
    "temperature": ("c", "°c", "degc", "deg c", "celsius", "deg. c"),
}


@dataclass(frozen=True, repr=False, eq=False)
class Tags:
    """A table of tags, one element a code; a tag with sensors has several codes.

    Parameters
    ----------
    tag : array (M,) of str
        Full id of the code, "A69-9006-501".
    animal : array (M,) of str
        Who carries it, "" = not said; codes of one animal make one track.
    sensor : array (M,) of str
        What the code's value means: "depth", "temperature", other words, "" = none.
    slope, intercept : array (M,) of float64
        Value in the sensor's unit = slope * number + intercept; NaN = the file's values are
        taken as they are.
    min_delay, max_delay : array (M,) of float64
        Limits of the burst interval, s; NaN = not known.
    start, end : array (M,) of int64
        When the animal carried it, ns since 1970 UTC; the smallest and the largest int64 = open.
    receiver : array (M,) of str, optional
        The receiver that it stands beside, of sync tags; "" = none.
    report : ReadReport
        What was read, and the notes made on the way.

    Raises
    ------
    InputError
        If lengths differ, a code is there twice, or limits are impossible.
    """

    tag: np.ndarray
    animal: np.ndarray
    sensor: np.ndarray
    slope: np.ndarray
    intercept: np.ndarray
    min_delay: np.ndarray
    max_delay: np.ndarray
    start: np.ndarray
    end: np.ndarray
    receiver: np.ndarray = None  # pyright: ignore[reportAssignmentType]
    report: ReadReport = field(default_factory=ReadReport)

    def __post_init__(self) -> None:
        tag = _arrays.text(self.tag, "tag")
        n = len(tag)
        checked = {"tag": tag}
        for name in ("animal", "sensor", "receiver"):
            given = getattr(self, name)
            checked[name] = _arrays.text(np.full(n, "", "U1") if given is None else given, name, n)
        for name in ("slope", "intercept", "min_delay", "max_delay"):
            checked[name] = _arrays.floats(getattr(self, name), name, (n,))
        for name in ("start", "end"):
            checked[name] = _arrays.times(getattr(self, name), name, n)
        names = [canonical(t) for t in map(str, tag)]
        for i, name in enumerate(names):
            if name in names[:i]:
                raise InputError(f"tag {tag[i]} is there twice", column="tag")
        lo, hi = checked["min_delay"], checked["max_delay"]
        bad = np.flatnonzero((lo <= 0) | (hi < lo))
        if len(bad):
            i = bad[0]
            raise InputError(f"burst interval of tag {tag[i]}: {lo[i]:g} to {hi[i]:g} s")
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(self.tag)

    def _row(self, name: str) -> int | None:
        key = canonical(name)
        found = [i for i, t in enumerate(map(str, self.tag)) if canonical(t) == key]
        return found[0] if found else None

    def limits(self, name: str) -> tuple[float, float] | None:
        """Return the limits (s) of the burst interval of a code or an animal, None = not known."""
        row = self._row(name)
        rows = [row] if row is not None else np.flatnonzero(self.animal == name).tolist()
        known = [i for i in rows if np.isfinite(self.min_delay[i] + self.max_delay[i])]
        if not known:
            return None
        return float(self.min_delay[known].min()), float(self.max_delay[known].max())

    def beside(self, receivers: Receivers) -> Receivers:
        """Return receivers with the sync tags that this table puts beside them.

        Raises
        ------
        InputError
            If a receiver is not among them, or has two sync tags.
        """
        tag = receivers.sync_tag.astype(object)
        given: dict[str, str] = {}
        for code, name in zip(self.tag, self.receiver, strict=True):
            if not name:
                continue
            known = str(receivers.canonical(np.array([str(name)]))[0])
            if known not in receivers.names:
                raise InputError(f"tag {code} stands beside {name}, which is not a receiver")
            if given.setdefault(known, str(code)) != code:
                raise InputError(f"receiver {name} has two sync tags: {given[known]}, {code}")
            tag[receivers.receiver == known] = str(code)
        return replace(receivers, sync_tag=tag.astype(str)) if given else receivers

    def apply(self, detections: Detections) -> Detections:
        """Return detections by animal, with their sensors' values in units.

        The tag of a detection becomes its animal where the table names one (the code is kept in
        ``extra["code"]``); ``extra["depth"]`` (m, down) and ``extra["temperature"]`` (C) are filled
        from the codes' sensors. Detections from before or after an animal carried a code keep
        the code as their tag, and are counted in a note.
        """
        codes = detections.tags
        rows = {c: self._row(c) for c in codes}
        tag = detections.tag.astype(object)
        extra = dict(detections.extra)
        notes = []
        raw = _numbers(extra.get("sensor"), len(detections))
        for code, row in rows.items():
            if row is None:
                continue
            mine = detections.tag == code
            inside = mine & (detections.time >= self.start[row]) & (detections.time < self.end[row])
            if n := int((mine & ~inside).sum()):
                text = f"{n} detections of {code} are from when {self.animal[row]} did not carry it"
                notes.append(Note("warning", text, n))
            if self.animal[row]:
                tag[inside] = str(self.animal[row])
            kind = str(self.sensor[row])
            if kind and np.isfinite(self.slope[row]) and raw is not None:
                value = self.slope[row] * raw[inside] + np.nan_to_num(self.intercept[row])
                column = extra.get(kind)
                column = np.full(len(raw), np.nan) if column is None else np.array(column, float)
                column[inside] = value
                extra[kind] = column
        strange = [c for c, r in rows.items() if r is None]
        if strange:
            text = f"not in the tags table: {', '.join(strange[:12])}"
            text += ", ..." if len(strange) > 12 else ""
            notes.append(Note("info", text, len(strange)))
        extra["code"] = detections.tag
        report = detections.report.add(*self.report.notes, *notes)
        return replace(detections, tag=tag.astype(str), extra=extra, report=report)

    def __repr__(self) -> str:
        animals = len(set(self.animal[self.animal != ""].tolist()))
        known = int(np.isfinite(self.min_delay).sum())
        return (
            f"Tags: {len(self)} codes of {animals} animals, {known} with limits of the burst "
            f"interval{self.report.flag}"
        )


def _numbers(values: np.ndarray | None, n: int) -> np.ndarray | None:
    if values is None:
        return None
    if values.dtype.kind in "iuf":
        return values.astype(float)
    out = np.full(n, np.nan)
    for i, v in enumerate(values):
        try:
            out[i] = np.nan if v is None else float(v)
        except ValueError:
            continue
    return out


def sensor_values(detections: Detections) -> Detections:
    """Fill ``extra["depth"]`` (m) and ``extra["temperature"]`` (C) from values that say their unit.

    Columns that are there already are left alone; raw counts (unit ADC, or none) are no values.
    """
    extra = dict(detections.extra)
    raw = _numbers(extra.get("sensor"), len(detections))
    unit = extra.get("sensor_unit")
    if raw is None or unit is None:
        return detections
    units = {u: str(u).strip().lower() for u in set(unit.tolist()) if isinstance(u, str)}
    notes = []
    for kind, words in UNITS.items():
        named = [u for u, low in units.items() if low in words]
        if named and kind not in extra:
            extra[kind] = np.where(np.isin(unit.astype(str), named), raw, np.nan)
    counts = [u for u, low in units.items() if low in ("adc", "counts", "raw")]
    if counts:
        n = int(np.isin(unit.astype(str), counts).sum())
        text = f"{n} sensor values are raw counts: a tags table with slope and intercept converts"
        notes.append(Note("info", text, n))
    return replace(detections, extra=extra, report=detections.report.add(*notes))
