"""Write docs/api.md from every public package's ``__all__`` and docstrings.

Run it after a public name is added: ``.venv/bin/python docs/write_api.py``; a test compares.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from pathlib import Path

import maloc

# Reached through the packages above them: readers through maloc.data, the command line in cli.md.
ELSEWHERE = {"maloc.cli", "maloc.readers"}
HEAD = """# Python names

Every public name, by the module to import it from; docstrings have shapes, units and errors.
This page is written by `docs/write_api.py`.
"""


def modules() -> list[str]:
    """Return ``maloc``, its public packages and modules, and the modules that these hand on."""
    found = {"maloc"}
    for info in pkgutil.walk_packages(maloc.__path__, "maloc."):
        private = any(part.startswith("_") for part in info.name.split("."))
        if not private and (info.ispkg or info.name.count(".") == 1):
            found.add(info.name)
    for name in sorted(found - ELSEWHERE):
        package = importlib.import_module(name)
        handed = [getattr(package, n) for n in getattr(package, "__all__", [])]
        found |= {m.__name__ for m in handed if inspect.ismodule(m)}
    return [m for m in sorted(found) if m not in ELSEWHERE]


def sentence(value: object) -> str:
    """Return the first paragraph of a docstring as one line."""
    own = inspect.ismodule(value) or inspect.isclass(value) or callable(value)
    text = inspect.getdoc(value) if own else f"A {type(value).__name__}."
    return " ".join((text or "").split("\n\n")[0].split()).replace("|", "\\|")


def page() -> str:
    """Return the whole page."""
    parts = [HEAD]
    for name in modules():
        module = importlib.import_module(name)
        if names := sorted(getattr(module, "__all__", []), key=str.lower):
            rows = [f"| `{n}` | {sentence(getattr(module, n))} |" for n in names]
            parts.append("\n".join([f"## `{name}`", "", "| name | |", "|---|---|", *rows, ""]))
    return "\n".join(parts)


if __name__ == "__main__":
    Path(__file__).with_name("api.md").write_text(page(), encoding="utf-8")
