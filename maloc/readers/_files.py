"""Files as bytes: gzip and zip undone, folders of one table a record type opened."""

from __future__ import annotations

import gzip
import io
import zipfile
import zlib
from pathlib import Path
from typing import NamedTuple

from maloc.errors import InputError
from maloc.readers._workbook import sheets

__all__ = ["File", "load", "load_all"]

GZIP = b"\x1f\x8b"
ZIP = b"PK\x03\x04"
_NOTHING = b" \t\r\n\xef\xbb\xbf\x00"
_SKIPPED = ("__MACOSX/", ".")  # what archives hold beside their files


class File(NamedTuple):
    """A file's name and its bytes, no longer packed."""

    name: str
    data: bytes


def load(path: str | Path) -> File:
    """Return the one file at `path`.

    Raises
    ------
    InputError
        If it is missing, empty, a folder, a broken archive, or an archive of several files.
    """
    found = load_all(path)
    if len(found) > 1:
        names = ", ".join(f.name for f in found[:8])
        raise InputError(
            f"holds {len(found)} files where one table is expected: {names}", file=str(path)
        )
    return found[0]


def load_all(path: str | Path) -> list[File]:
    """Return every file at `path`: itself, the members of a zip archive, or a folder's tables.

    Raises
    ------
    InputError
        If it is missing, empty, or a broken archive.
    """
    path = Path(path)
    name = str(path)
    try:
        if path.is_dir():
            return _folder(path)
        data = path.read_bytes()
    except FileNotFoundError:
        raise InputError("no such file", file=name) from None
    except OSError as e:
        raise InputError(f"cannot be read ({e.strerror or e})", file=name) from None
    found = _unpack(name, data)
    for f in found:
        if not (f.data[:4096].strip(_NOTHING) or f.data.strip(_NOTHING)):
            raise InputError("empty file", file=f.name)
    return found


def _folder(path: Path) -> list[File]:
    """Return the tables of a folder that Fathom split into one CSV a record type."""
    if not path.name.endswith("csv-fathom-split"):
        raise InputError("is a folder, a file is expected", file=str(path))
    tables = sorted(p for p in path.iterdir() if p.suffix.lower() == ".csv")
    if not tables:
        raise InputError("a folder without CSV files", file=str(path))
    return [File(str(p), p.read_bytes()) for p in tables]


def _unpack(name: str, data: bytes) -> list[File]:
    try:
        if data[:2] == GZIP:
            return [File(name, gzip.decompress(data))]
        if data[:4] == ZIP:
            return _members(name, data)
    except (gzip.BadGzipFile, EOFError, zlib.error) as e:
        raise InputError(f"broken gzip file ({e})", file=name) from None
    except (zipfile.BadZipFile, RuntimeError) as e:
        raise InputError(
            f"broken or locked zip archive, or Excel workbook ({e})", file=name
        ) from None
    return [File(name, data)]


def _members(name: str, data: bytes) -> list[File]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        inside = [
            m
            for m in archive.namelist()
            if not m.endswith("/") and not m.startswith(_SKIPPED) and "/." not in m
        ]
        if "[Content_Types].xml" in inside:  # an Excel workbook is a zip archive too
            return [File(*sheet) for sheet in sheets(name, data)]
        if not inside:
            raise InputError("an archive without files", file=name)
        return [File(f"{name}/{m}", archive.read(m)) for m in inside]
