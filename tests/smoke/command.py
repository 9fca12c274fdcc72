"""The command as a user runs it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

TAGS = ("A69-1602-1001", "A69-1602-1002")
INTERVAL = ("20.6", "36.6")


def maloc(*args: object) -> str:
    """Run the command in a process of its own, as a user does, and return what it said.

    The environment's ``PYTHONWARNINGS`` counts there, as pytest's filters do in this process.
    """
    command = [str(Path(sys.executable).with_name("maloc")), *map(str, args)]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, timeout=280, env=os.environ
    )
    assert done.returncode == 0, f"maloc {' '.join(command[1:])}\n{done.stderr}{done.stdout}"
    assert "Traceback" not in done.stderr, done.stderr
    return done.stdout + done.stderr
