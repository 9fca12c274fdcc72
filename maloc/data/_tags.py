"""Tag ids: kept whole ("A69-1602-15266"), found by any unique ending after a dash."""

from __future__ import annotations

from collections.abc import Iterable

from maloc.data._codespaces import canonical
from maloc.errors import InputError

__all__ = ["match_tag"]


def match_tag(tags: Iterable[str], short: object) -> str:
    """Return the one full tag id that `short` means.

    Parameters
    ----------
    tags : iterable of str
        Full ids known.
    short : str or int
        A full id, or its ending after a dash ("15266" or "1602-15266" for "A69-1602-15266"), or
        another maker's name for it ("A69-1303-345" for "R64K-345").

    Returns
    -------
    str
        The full id.

    Raises
    ------
    InputError
        If no tag ends so (the tags are listed) or several do (the candidates are listed).
    """
    known = sorted(set(map(str, tags)))
    wanted = str(short).strip()
    if wanted in known:
        return wanted
    found = [t for t in known if t.endswith(f"-{wanted}")] if wanted else []
    found = found or [t for t in known if canonical(t) == canonical(wanted)]
    if len(found) == 1:
        return found[0]
    if found:
        raise InputError(
            f"tag '{wanted}' is ambiguous, {len(found)} transmitters: {_listed(found)}",
            mend="give the full id",
        )
    raise InputError(f"no tag '{wanted}' in the detections; tags there: {_listed(known) or 'none'}")


def _listed(names: list[str], most: int = 20) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more
