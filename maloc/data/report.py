"""What was read, and every note about it: it travels along, so that no row vanishes silently."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import dataclass, field, replace

from maloc.errors import MalocWarning

__all__ = ["Note", "ReadReport"]

LEVELS = ("info", "warning", "error")


@dataclass(frozen=True)
class Note:
    """One thing worth saying about an input.

    Parameters
    ----------
    level : {"info", "warning", "error"}
        How bad it is; an "error" makes the file useless for what was asked.
    text : str
        One sentence.
    count : int
        How many rows it concerns.
    file : str, optional
        File name.
    row : int, optional
        Line of the file (1 = first line) of the first row concerned.
    """

    level: str
    text: str
    count: int = 1
    file: str | None = None
    row: int | None = None

    def __post_init__(self) -> None:
        if self.level not in LEVELS:
            raise ValueError(f"level must be one of {LEVELS}, got {self.level!r}")

    def __str__(self) -> str:
        where = "" if self.file is None else f"{self.file}: "
        return f"{self.level}: {where}{self.text}"


@dataclass(frozen=True)
class ReadReport:
    """Format, files, number of rows, and the notes made while reading.

    Parameters
    ----------
    format : str
        Name of the format that was recognised.
    files : tuple of str
        File names, in the order read.
    rows : int
        Rows kept.
    notes : tuple of Note
        In the order they were made.
    """

    format: str = ""
    files: tuple[str, ...] = ()
    rows: int = 0
    notes: tuple[Note, ...] = field(default=())

    @property
    def warnings(self) -> tuple[Note, ...]:
        """The notes of level "warning"."""
        return tuple(n for n in self.notes if n.level == "warning")

    @property
    def errors(self) -> tuple[Note, ...]:
        """The notes of level "error"."""
        return tuple(n for n in self.notes if n.level == "error")

    def add(self, *notes: Note) -> ReadReport:
        """Return a report with these notes appended; ones already there are not repeated."""
        new = [n for n in dict.fromkeys(notes) if n not in self.notes]
        return replace(self, notes=self.notes + tuple(new))

    def note(
        self,
        level: str,
        text: str,
        *,
        count: int = 1,
        file: str | None = None,
        row: int | None = None,
    ) -> ReadReport:
        """Return a report with one more note."""
        return self.add(Note(level, text, count, file, row))

    def warn(self, stacklevel: int = 3) -> None:
        """Issue every "warning" and "error" note as a `MalocWarning`."""
        for n in self.notes:
            if n.level != "info":
                where = "" if n.file is None else f"{n.file}: "
                warnings.warn(f"{where}{n.text}", MalocWarning, stacklevel=stacklevel)

    @property
    def flag(self) -> str:
        """Return ", 2 warnings (see .report)" for a repr; "" when there is nothing to warn of."""
        n = len(self.warnings) + len(self.errors)
        return f", {n} warning{'s' * (n != 1)} (see .report)" if n else ""

    @classmethod
    def merge(cls, reports: Iterable[ReadReport]) -> ReadReport:
        """Join reports: formats and files without repeats, rows added, notes in order."""
        reports = list(reports)
        formats = dict.fromkeys(r.format for r in reports if r.format)
        files = dict.fromkeys(f for r in reports for f in r.files)
        notes = dict.fromkeys(n for r in reports for n in r.notes)
        return cls(" + ".join(formats), tuple(files), sum(r.rows for r in reports), tuple(notes))

    def __str__(self) -> str:
        head = f"{self.format or 'unknown format'}, {self.rows} rows, {', '.join(self.files)}"
        return "\n".join([head.rstrip(", "), *(f"  {n}" for n in self.notes)])
