"""The thesis's simulation study in a canal: ``python -m simulations.canal --tracks 20``.

The same as ``maloc study canal``, whose options it takes (``--help`` lists them). The simulator is
`maloc.simulate.canal`; cases, methods, scores and tables are in `maloc.studies.canal`.
"""

from __future__ import annotations

import sys

from maloc.cli import app


def main(argv: list[str] | None = None) -> int:
    """Run the command; return its exit code."""
    asked = sys.argv[1:] if argv is None else argv
    try:
        app(["study", "canal", *asked], prog_name="maloc")
    except SystemExit as end:
        return int(end.code or 0)
    return 0


if __name__ == "__main__":
    sys.exit(main())
