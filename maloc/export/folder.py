"""Output folders that appear whole or not at all: built beside their place, then renamed."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from maloc.errors import InputError

__all__ = ["check_free", "output_folder"]

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EIO)
MARK = "summary.json"  # every folder that maloc writes has one; only such a folder is replaced


def check_free(out: Path, force: bool) -> None:
    """Refuse a place that is taken, before any work is done.

    Parameters
    ----------
    out : Path
        Where the folder will lie.
    force : bool
        Replace an earlier output of maloc's (or an empty folder).

    Raises
    ------
    InputError
        If something is there and `force` is off, or if it is not an output of maloc's.
    """
    out = Path(out)
    if not os.path.lexists(out):
        return
    if not force:
        raise InputError("exists already", file=out, mend="give another --out, or --force")
    if out.is_symlink() or not out.is_dir():
        raise InputError(
            "is not a folder; --force replaces only folders that maloc wrote", file=out
        )
    if any(out.iterdir()) and not (out / MARK).is_file():
        raise InputError(
            f"is not an output of maloc's (no {MARK}); --force replaces only those",
            file=out,
            mend="give another --out",
        )


@contextmanager
def output_folder(out: Path, force: bool = False) -> Iterator[Path]:
    """Give a folder to write in, and put it in its place only when all went well.

    Parameters
    ----------
    out : Path
        Where the folder will lie; parents are made.
    force : bool
        Replace an earlier output of maloc's.

    Yields
    ------
    Path
        A temporary folder beside `out`. On an exception it is removed, with the parents made
        for it, and what lay at `out` before is untouched.

    Raises
    ------
    InputError
        As `check_free`, or where the place cannot be written.
    """
    out = Path(out).absolute()
    check_free(out, force)
    made = _make_parents(out.parent)
    try:
        try:
            work = Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=out.parent))
        except OSError as problem:
            raise InputError(f"cannot be written ({problem.strerror})", file=out) from problem
        try:
            yield work
            work.chmod(0o777 & ~_umask())
            _put(work, out, force)
        except BaseException as problem:
            shutil.rmtree(work, ignore_errors=True)
            if isinstance(problem, OSError) and problem.errno in FULL:
                raise InputError(f"cannot be written ({problem.strerror})", file=out) from problem
            raise
    except BaseException:
        for folder in made:
            try:
                folder.rmdir()
            except OSError:  # somebody else has put something there meanwhile
                break
        raise


def _put(work: Path, out: Path, force: bool) -> None:
    """Rename `work` to `out`; an earlier output steps aside first and is removed last."""
    check_free(out, force)
    old = None
    if out.exists():
        old = Path(tempfile.mkdtemp(prefix=f".{out.name}.old.", dir=out.parent))
        os.rename(out, old / "old")
    try:
        os.rename(work, out)
    except BaseException:
        if old is not None:
            os.rename(old / "old", out)
            old.rmdir()
        raise
    if old is not None:
        shutil.rmtree(old, ignore_errors=True)


def _make_parents(folder: Path) -> list[Path]:
    """Make missing parents; return those made, innermost first."""
    missing = []
    while not folder.exists():
        missing.append(folder)
        folder = folder.parent
    made: list[Path] = []
    for path in reversed(missing):
        try:
            path.mkdir()
        except FileExistsError:
            continue
        except OSError as problem:
            for done in made:
                done.rmdir()
            raise InputError(f"cannot be made ({problem.strerror})", file=path) from problem
        made.insert(0, path)
    return made


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
