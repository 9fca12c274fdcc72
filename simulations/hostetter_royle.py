"""The study of Hostetter & Royle (2020): ``python -m simulations.hostetter_royle --datasets 20``.

The same as ``maloc study hostetter-royle``, whose options it takes (``--help`` lists them). The
simulator is `maloc.simulate.hostetter_royle`, jobs and scores are in
`maloc.studies.hostetter_royle`.
"""

from __future__ import annotations

import sys

from maloc.cli import app


def main(argv: list[str] | None = None) -> int:
    """Run the command; return its exit code."""
    asked = sys.argv[1:] if argv is None else argv
    try:
        app(["study", "hostetter-royle", *asked], prog_name="maloc")
    except SystemExit as end:
        return int(end.code or 0)
    return 0


if __name__ == "__main__":
    sys.exit(main())
