"""Commands whose every failure is one line on stderr and an exit code."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable
from typing import Any

import typer
from typer.core import TyperGroup

from maloc.errors import FitError, InputError

__all__ = ["BAD_INPUT", "OneLineGroup", "explained", "fail"]

BAD_INPUT, FAILED_FIT, INTERRUPTED = 2, 1, 130


class OneLineGroup(TyperGroup):
    """Commands whose every failure is one line on stderr and an exit code."""

    def main(self, *args: Any, standalone_mode: bool = True, **kwargs: Any) -> Any:
        """Run, and turn usage errors into one line and exit code 2."""
        try:
            code = super().main(*args, standalone_mode=False, **kwargs)
        except Exception as problem:
            text = getattr(problem, "format_message", None)
            if text is None:
                raise
            context = getattr(problem, "ctx", None)
            name = context.command_path if context is not None else "maloc"
            code = fail(f"{text().rstrip('.')} (see {name} --help)", BAD_INPUT)
        if standalone_mode:
            sys.exit(code if isinstance(code, int) else 0)
        return code


def fail(text: object, code: int) -> int:
    """Say what went wrong in one line on stderr, and return the exit code."""
    print(f"maloc: error: {' '.join(str(text).split())}", file=sys.stderr)
    return code


def explained(command: Callable) -> Callable:
    """Wrap a command so that explained failures are one line and an exit code."""

    @functools.wraps(command)
    def run(*args: Any, **kwargs: Any) -> None:
        try:
            command(*args, **kwargs)
        except InputError as problem:
            raise typer.Exit(fail(problem, BAD_INPUT)) from None
        except FitError as problem:
            raise typer.Exit(fail(problem, FAILED_FIT)) from None
        except typer.Exit:
            raise
        except Exception as problem:
            from maloc._package.version import outside

            if not (line := outside()):
                raise
            reason = f"{type(problem).__name__}: {problem}"
            raise typer.Exit(fail(f"{line}, and failed: {reason}", FAILED_FIT)) from None
        except KeyboardInterrupt:
            raise typer.Exit(fail("interrupted", INTERRUPTED)) from None

    return run
