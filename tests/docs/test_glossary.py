"""Public names are made of words, or of short forms that the glossary explains."""

from __future__ import annotations

import importlib
import inspect
import re
import sys
from collections.abc import Iterator

import numpyro.distributions as dist
import typer
from spellchecker import SpellChecker

from tests.docs import pages

sys.path.insert(0, str(pages.ROOT / "docs"))
modules = importlib.import_module("write_api").modules

# English spellings of words that the dictionary has in the American one, and three names.
_SPELLING = (
    (r"our", "or"),
    (r"tre$", "ter"),
    (r"is(e|ed|ation)$", r"iz\1"),
    (r"^(maloc|hostetter|royle)$", "name"),
)
_SHORT = 3
_LITTLE = {"as", "at", "by", "in", "is", "of", "ok", "on", "to"}


def _names() -> Iterator[tuple[str, str]]:
    """Every public name with where it stands: modules, objects, their attributes, arguments."""
    for module in modules():
        yield from ((part, module) for part in module.split("."))
        home = importlib.import_module(module)
        for name in getattr(home, "__all__", ()):
            value = getattr(home, name)
            if not inspect.ismodule(value):
                yield from _of(value, name, f"{module}.{name}")
    yield from _of_command(typer.main.get_command(importlib.import_module("maloc.cli").app))


def _of(value, name: str, where: str) -> Iterator[tuple[str, str]]:
    yield name, where
    if inspect.isclass(value):
        own = set(vars(value)) | set(getattr(value, "__dataclass_fields__", ()))
        given = set(dir(dist.Distribution))  # names that NumPyro, not maloc, gave
        for attribute in own - given:
            if not attribute.startswith("_") and attribute != "pytree_aux_fields":
                member = vars(value).get(attribute)
                yield attribute, f"{where}.{attribute}"
                if inspect.isfunction(member):
                    yield from ((a, where) for a in inspect.signature(member).parameters)
    if callable(value):
        try:
            yield from ((a, where) for a in inspect.signature(value).parameters)
        except ValueError:  # built in
            return


def _of_command(command) -> Iterator[tuple[str, str]]:
    for option in command.params:
        yield from ((o, command.name) for o in option.opts if o.startswith("--"))
    for one in getattr(command, "commands", {}).values():
        yield one.name, "maloc"
        yield from _of_command(one)


def _words(name: str) -> list[str]:
    return [w.lower() for w in re.findall(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+", name)]


def _ordinary(word: str, known: SpellChecker) -> bool:
    others = [re.sub(old, new, word) for old, new in _SPELLING]
    return any(w in known for w in (word, *others))


def test_short_forms_are_in_the_glossary():
    glossary = (pages.ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
    first = re.findall(r"^\| ([^|]+) \|", glossary, flags=re.M)
    explained = {w for cell in first for w in _words(cell)}
    known, missing = SpellChecker(), {}
    for name, where in _names():
        for word in _words(name):
            short = len(word) < _SHORT and word not in _LITTLE
            if (short or not _ordinary(word, known)) and not {
                word,
                word.removesuffix("s"),
            } & explained:
                missing.setdefault(word, where)
    assert missing == {}
