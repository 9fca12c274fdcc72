"""What a command says while it runs, and what it remembers of it for summary.json."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any

from maloc.data._stages import Stages
from maloc.errors import MalocWarning

__all__ = ["Log"]


class Log:
    """Notices and warnings on stderr, each once, and seconds by stage.

    What is said before `release` is held back, so that refused input leaves one line on stderr:
    the reason.

    Parameters
    ----------
    quiet : bool
        Say nothing but warnings.
    """

    def __init__(self, quiet: bool = False) -> None:
        self.quiet = quiet
        self._held: list[str] | None = []
        self.notices: list[str] = []
        self.warnings: list[str] = []
        self.seconds = Stages()

    def notice(self, text: str) -> None:
        """Say something on stderr, unless quiet."""
        if text not in self.notices:
            self.notices.append(text)
            if not self.quiet:
                self._say(f"maloc: {text}")

    def warn(self, text: str) -> None:
        """Warn on stderr, quiet or not."""
        text = " ".join(text.split())
        if text not in self.warnings:
            self.warnings.append(text)
            self._say(f"maloc: warning: {text}")

    def _say(self, line: str) -> None:
        if self._held is None:
            print(line, file=sys.stderr)
        else:
            self._held.append(line)

    def release(self) -> None:
        """Say what was held back, and everything from now on at once."""
        held, self._held = self._held or [], None
        for line in held:
            self._say(line)

    def report(self, report: Any) -> None:
        """Pass on a `ReadReport`'s notes, the ones of level "info" as notices."""
        for note in report.notes:
            text = note.text if note.file is None else f"{note.file}: {note.text}"
            (self.notice if note.level == "info" else self.warn)(text)

    def stage(self, name: str) -> AbstractContextManager[None]:
        """Add wall and CPU seconds of what happens inside to stage `name`."""
        return self.seconds.time(name)

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Take `MalocWarning`s raised inside as warnings of the command."""
        with warnings.catch_warnings():
            usual = warnings.showwarning

            def show(message, category, filename, lineno, file=None, line=None):
                if issubclass(category, MalocWarning):
                    self.warn(str(message))
                else:
                    usual(message, category, filename, lineno, file, line)

            warnings.simplefilter("always", MalocWarning)
            warnings.showwarning = show
            yield
