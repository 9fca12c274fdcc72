"""The sequence of a tag's burst intervals, one number a line."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from maloc.errors import InputError

__all__ = ["read_sequence"]


def read_sequence(path: Path) -> np.ndarray:
    """Burst intervals of a tag in their order, s: one number a line, a heading at most.

    Raises
    ------
    InputError
        If the file cannot be read, a line is no positive number, or there are none.
    """
    try:
        rows = path.read_text(encoding="utf-8-sig").split("\n")
    except (OSError, UnicodeDecodeError) as problem:
        raise InputError(f"cannot be read: {problem}", file=path) from None
    found = []
    for i, text in enumerate(rows, 1):
        if not (cell := text.strip().strip(",;")):
            continue
        try:
            value = float(cell)
        except ValueError:
            if not found and i == 1:
                continue  # a heading
            value = float("nan")
        if not (np.isfinite(value) and value > 0):
            raise InputError(
                f"'{cell}' is no burst interval", file=path, row=i, mend="give seconds, one a line"
            )
        found.append(value)
    if not found:
        raise InputError("holds no burst intervals", file=path)
    return np.array(found)
