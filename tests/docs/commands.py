"""Whether a shell line could run: command, options and values, by the programs' own parsers."""

from __future__ import annotations

import argparse
import importlib
import re
import shlex
import tomllib
from pathlib import Path
from typing import Any

import typer

ROOT = Path(__file__).resolve().parents[2]


class _Parsed(Exception):
    """The arguments are in order."""


def lines(text: str) -> list[str]:
    """Return a block's commands, lines that go on joined."""
    joined = text.replace("\\\n", " ")
    return [line for line in joined.splitlines() if line.strip() and not line.startswith("%%")]


def check(line: str) -> None:
    """Raise where a command or an option does not exist, or a value does not fit."""
    for part in re.split(r"&&|\|(?!\w)", line):
        words = shlex.split(part, comments=True)
        if words:
            _check(words)


def _check(words: list[str]) -> None:
    program, rest = words[0], words[1:]
    if program == "maloc":
        parse(rest)
    elif program == "make":
        text = (ROOT / "Makefile").read_text()
        targets = re.findall(r"^([\w-]+):", text, flags=re.M)
        targets += [f"{name}=" for name in re.findall(r"^(\w+) \?=", text, flags=re.M)]
        asked = {re.sub(r"=.*", "=", word) for word in rest}
        assert rest and asked <= set(targets), f"make has no {sorted(asked - set(targets))}"
    elif program == "pip":
        extras(" ".join(rest))
    elif words[:2] in (["python", "-m"], [".venv/bin/python", "-m"]):
        _module(rest[1], rest[2:])
    else:
        assert program in ("head", "ls", "git", "cd"), f"unknown program {program}"


def parse(words: list[str]) -> None:
    """Parse a maloc command line without running it."""
    command, name = _find(words)
    command.make_context(name, words[len(name.split()) - 1 :])


def _find(words: list[str]) -> tuple[Any, str]:
    from maloc.cli import app

    command: Any = typer.main.get_command(app)
    name = ["maloc"]
    while hasattr(command, "commands") and words and not words[0].startswith("-"):
        assert words[0] in command.commands, f"no command {' '.join([*name, words[0]])}"
        command, words = command.commands[words[0]], [*words[1:]]
        name.append(command.name)
    return command, " ".join(name)


def known_options(text: str) -> None:
    """Raise where a synopsis or a phrase names a command or an option that does not exist."""
    words = text.split()[1:]
    command, name = _find([w for w in words[:2] if re.fullmatch(r"[a-z-]+", w)])
    known = {o for p in command.params for o in (*p.opts, *p.secondary_opts)}
    used = set(re.findall(r"(?<![\w-])--[a-z][a-z-]*", text))
    assert used <= known | {"--help"}, f"{name} has no {sorted(used - known)}"


def extras(text: str) -> None:
    """Raise where ``maloc[extra]`` names an extra that does not exist."""
    config = tomllib.loads((ROOT / "pyproject.toml").read_text())
    for found in re.findall(r"maloc\[(\w+)\]", text):
        assert found in config["project"]["optional-dependencies"], f"no extra {found}"


def _module(name: str, words: list[str]) -> None:
    """Parse the arguments of ``python -m benchmarks.NAME`` by its own parser, and stop there."""
    assert name.split(".")[0] in ("benchmarks", "simulations", "pytest"), name
    if name == "pytest":
        return
    import sys
    from unittest.mock import patch

    own = argparse.ArgumentParser.parse_args

    def stop(parser, args=None, namespace=None):
        own(parser, args, namespace)
        raise _Parsed

    module = importlib.import_module(name)
    with (
        patch.object(argparse.ArgumentParser, "parse_args", stop),
        patch.object(sys, "argv", [name, *words]),
    ):
        try:
            module.main()
        except _Parsed:
            return
    raise AssertionError(f"{name} parses no arguments")
