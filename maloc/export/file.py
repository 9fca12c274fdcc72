"""What `maloc export` does: one file, whole or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path

from maloc.errors import InputError

__all__ = ["export_file"]


def export_file(run: Path, to: str, out: Path, *, force: bool = False) -> str:
    """Write a finished run in a format; written beside its place first, then renamed.

    Returns
    -------
    str
        What was written.

    Raises
    ------
    InputError
        As `maloc.export.write`, or `out` is taken or cannot be written.
    """
    from maloc.export import FORMATS, read_finished, write

    if to not in FORMATS:
        raise InputError(f"--to {to} is none of {', '.join(FORMATS)}")
    out = Path(out).absolute()
    if os.path.lexists(out) and not force:
        raise InputError("exists already", file=out, mend="give another --out, or --force")
    if out.is_dir() and to != "zarr":
        raise InputError("is a folder", file=out, mend="give the name of a file")
    if out.is_dir() and not any((out / name).exists() for name in ("zarr.json", ".zgroup")):
        raise InputError("is a folder that is no Zarr store", file=out, mend="give another --out")
    finished = read_finished(run)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        work = Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=out.parent))
    except OSError as problem:
        raise InputError(f"cannot be written ({problem.strerror})", file=out) from problem
    try:
        write(finished, work / out.name, to)
        if out.is_dir():
            shutil.rmtree(out)
        os.replace(work / out.name, out)
    except OSError as problem:
        raise InputError(f"cannot be written ({problem.strerror})", file=out) from problem
    finally:
        shutil.rmtree(work, ignore_errors=True)
    left = f", {finished.left_out} without a position left out" if finished.left_out else ""
    return f"{len(finished.table)} rows written to {out.name} ({FORMATS[to].use}){left}"
