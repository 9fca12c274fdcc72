"""Write a column of docs/versions.md: ``PYTHON docs/write_versions.py`` after a leg has passed.

PYTHON is the interpreter of the environment that the leg ran in (``.venv/bin/python`` of
``make test``, ``.venv-newest/bin/python``, ``.venv-oldest/bin/python``); the versions are what is
installed there. A column of the same leg and Python is replaced, others stay.
"""

from __future__ import annotations

import datetime
import platform
import re
import sys
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement

PAGE = Path(__file__).with_name("versions.md")
LEGS = {".venv": "make test", ".venv-newest": "newest", ".venv-oldest": "oldest"}
HEAD = """# What was run with which versions

`make test` runs everything with the versions of `constraints.txt`. `make test-newest
PYTHON=python3.13` and `make test-oldest` run the smoke tests: a raw export to every output, the
interface of the README, the exports, ArviZ, SVI with k-hat, NUTS, many tags by Dask, and what
leans on an optional package. The newest leg takes no constraints, and a deprecation is an error in
it; the oldest leg installs the lowest versions that `pyproject.toml` allows (uv's `lowest-direct`).

maloc warns where JAX, NumPyro or ArviZ lie outside the range that was run
(`maloc._package.version`).
A column is written by `docs/write_versions.py`, in the environment of a leg that has passed.
"""


def packages() -> list[str]:
    """What maloc asks for, the extras of users included, in the order of pyproject.toml."""
    asked = [Requirement(text) for text in metadata.requires("maloc") or ()]
    extras = [
        e
        for e in metadata.metadata("maloc").get_all("Provides-Extra") or ()
        if e not in ("test", "docs")
    ]
    wanted = [
        r.name
        for r in asked
        if r.name != "maloc"
        and (r.marker is None or any(r.marker.evaluate({"extra": e}) for e in extras))
    ]
    return list(dict.fromkeys(wanted))


def column() -> tuple[str, dict[str, str]]:
    """Name of the leg that this interpreter belongs to, and a version a row."""
    environment = Path(sys.prefix)
    leg = LEGS.get(environment.name)
    if leg is None or not (environment / ".passed").exists():
        sys.exit(f"{environment} is not the environment of a leg that has passed")
    run = datetime.date.fromtimestamp((environment / ".passed").stat().st_mtime)
    found = {"run on": run.isoformat(), "Python": platform.python_version()}
    for name in packages():
        found[name] = metadata.version(name)
    return f"{leg}, {'.'.join(platform.python_version_tuple()[:2])}", found


def table(text: str) -> dict[str, dict[str, str]]:
    """Columns of the page as it stands."""
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in text.splitlines()
        if re.match(r"\| ", line)
    ]
    names = rows[0][1:] if rows else []
    return {n: {row[0]: row[i + 1] for row in rows[1:]} for i, n in enumerate(names)}


def page(columns: dict[str, dict[str, str]], rows: list[str]) -> str:
    """The whole page."""
    lines = ["| | " + " | ".join(columns) + " |", "|" + "---|" * (len(columns) + 1)]
    lines += [f"| {r} | " + " | ".join(c.get(r, "") for c in columns.values()) + " |" for r in rows]
    return "\n".join([HEAD, *lines, ""])


if __name__ == "__main__":
    name, found = column()
    known = table(PAGE.read_text(encoding="utf-8")) if PAGE.exists() else {}
    PAGE.write_text(page(dict(sorted((known | {name: found}).items())), list(found)), "utf-8")
