"""The command line `maloc`: options in, a call out.

Comes in: what was typed.
Goes out: one call of `maloc.runs`, `maloc.readers.check`, `maloc.simulate`, `maloc.export` or
    `maloc.studies`; lines on the terminal, an exit code.
Start reading: `commands.py`; `track` and `points` are in `tracks.py`, shared options in
    `options.py`. Nothing is worked out here.
The page: docs/cli.md.
"""

from maloc.cli.commands import app, main

__all__ = ["app", "main"]
