"""The command line `maloc`: options in, a call out."""

from maloc.cli.commands import app, main

__all__ = ["app", "main"]
