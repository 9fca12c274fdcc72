"""Write the reference of the site: a page a public module, a page of the commands.

Called by ``conf.py``; nothing that it writes is committed.
"""

from __future__ import annotations

import importlib
import inspect
from pathlib import Path
from types import ModuleType

from write_api import modules

_HEAD = """Reference
=========

Every public name, from its docstring: shapes, units, what it raises, and where it comes from.
On one page: :doc:`/api`. Options of the commands: :doc:`commands`; what they are for: :doc:`/cli`.
Tables in and out: :doc:`/formats`.

.. toctree::
   :maxdepth: 1

"""


def write(folder: Path) -> None:
    """Write all pages; a page that has not changed keeps its date, so that Sphinx skips it."""
    folder.mkdir(parents=True, exist_ok=True)
    pages, seen = {}, {}
    for name in modules():
        if page := _module(importlib.import_module(name), name, seen):
            pages[f"{name}.rst"] = page
    listed = "".join(f"   {name.removesuffix('.rst')}\n" for name in pages)
    pages["index.rst"] = f"{_HEAD}{listed}   commands\n"
    pages["commands.md"] = _commands()
    for old in folder.iterdir():
        if old.name not in pages:
            old.unlink()
    for name, text in pages.items():
        file = folder / name
        if not file.exists() or file.read_text(encoding="utf-8") != text:
            file.write_text(text, encoding="utf-8")


def _module(module: ModuleType, name: str, seen: dict[int, str]) -> str:
    """Return the page of one module; names that an earlier page has are only pointed to."""
    names = [n for n in sorted(getattr(module, "__all__", ()), key=str.lower)]
    values = {n: getattr(module, n) for n in names}
    values = {n: v for n, v in values.items() if not inspect.ismodule(v)}
    if not values:
        return ""
    new = [n for n, v in values.items() if seen.setdefault(id(v), f"{name}.{n}") == f"{name}.{n}"]
    parts = [f"{name}\n{'=' * len(name)}\n", f".. automodule:: {name}\n   :no-members:\n"]
    table = "".join(f"   {seen[id(v)].removeprefix(name + '.')}\n" for v in values.values())
    parts.append(f".. autosummary::\n   :nosignatures:\n\n{table}")
    parts += [_entry(f"{name}.{n}", values[n]) for n in new]
    return "\n".join(parts)


def _entry(name: str, value: object) -> str:
    short = name.rsplit(".", 1)[1]
    heading = f"{short}\n{'-' * len(short)}\n\n"
    if inspect.isclass(value):
        return f"{heading}.. autoclass:: {name}\n   :members:\n"
    return f"{heading}.. {'autofunction' if callable(value) else 'autodata'}:: {name}\n"


def _commands() -> str:
    """Return every command's help and options, by Typer's own writer of documents."""
    import typer
    from typer.cli import get_docs_for_click

    from maloc.cli import app

    command = typer.main.get_command(app)
    context = typer.Context(command, info_name="maloc")
    return get_docs_for_click(obj=command, ctx=context, name="maloc", title="Options")
