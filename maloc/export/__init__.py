"""Tracks as other programs read them: tables of `maloc track` or `maloc predict` written anew."""

from maloc.export.formats import FORMATS, Finished, ellipse_axes, read_finished, write

__all__ = ["FORMATS", "Finished", "ellipse_axes", "read_finished", "write"]
