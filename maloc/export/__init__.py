"""Tracks as other programs read them: tables of `maloc track` or `maloc predict` written anew.

Comes in: a finished run, read back as tables (`finished.py`).
Goes out: files of other programs; and the folders that every command writes, whole or not at all
    (`folder.py`).
Start reading: `formats.py`. Nothing here knows a model.
The page: docs/after.md.
"""

from maloc.export.formats import FORMATS, Finished, ellipse_axes, read_finished, write

__all__ = ["FORMATS", "Finished", "ellipse_axes", "read_finished", "write"]
