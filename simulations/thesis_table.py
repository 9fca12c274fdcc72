"""Table C.1 of the thesis and its classical columns: ``python -m simulations.thesis_table``.

The canal study (`maloc.studies.canal`) with the fish kept to the canal between its receivers, as
the thesis's "remained close to the array": least squares, the three outlier filters after it,
Kalman filter and smoother after those, EK-TOA, `toa_track` and `maloc.models.yaps`, cell by cell,
beside the thesis's values.
Where the set-ups differ, and what that does, is in docs/classical.md.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from maloc.errors import InputError
from maloc.simulate.canal import CanalDesign
from maloc.studies.canal.cases import own_cases
from maloc.studies.canal.study import Settings, run_canal
from maloc.studies.canal.tables import mean_of
from maloc.studies.canal.thesis import STEPS_C1, TABLE_C1

if TYPE_CHECKING:
    import polars as pl

__all__ = ["main", "tables"]

CHAIN = ("speed", "two", "three", "kf", "rts", "kf-wide", "rts-wide")
OURS = ("toa", "yaps", "{base}", *(f"{{base}}-{step}" for step in CHAIN), "ek-toa")


def tables(results: pl.DataFrame, base: str) -> str:
    """Mean errors by cell beside the thesis's, pings kept, and the two statements asked of them.

    Parameters
    ----------
    results : DataFrame
        What `maloc.studies.canal.study.run_canal` returns, of the methods in `OURS`.
    base : {"ls", "de"}
        Where the positions come from.
    """
    import polars as pl

    methods = results["method"].unique(maintain_order=True).to_list()
    heard = results.filter((pl.col("section") == "position") & (pl.col("n_heard") > 0))
    parts = heard.partition_by("p_na", "p_mp", "method", as_dict=True)
    cells = sorted({key[:2] for key in parts})
    heads = [m.removeprefix(f"{base}-") for m in methods]
    theirs = ("YAPS", "LS", "outl.", "KF", "RTSS")
    lines = [
        f"Mean error, m, of {results['track'].n_unique()} tracks a cell; the thesis's on the right",
        f"{'NA / MP':>12}" + "".join(f"{h:>9}" for h in heads) + "  |"
        + "".join(f"{t:>7}" for t in theirs),
    ]  # fmt: skip
    mean: dict[tuple, float] = {}
    for cell in cells:
        line = f"{cell[0]:.2f} / {cell[1]:.2f}".rjust(12)
        for m in methods:
            found = parts[*cell, m].filter(pl.col("error").is_finite())
            mean[*cell, m] = mean_of(found)[0]
            line += f"{mean[*cell, m]:>9.2f}"
        lines.append(line + "  |" + "".join(f"{v:>7.2f}" for v in _theirs(cell)))
    lines += ["", "Share of the heard pings that have a position", lines[1].split("  |")[0]]
    for cell in cells:
        share = (parts[*cell, m]["error"].is_finite().mean() for m in methods)
        label = f"{cell[0]:.2f} / {cell[1]:.2f}"
        lines.append(f"{label:>12}" + "".join(f"{v:>9.3f}" for v in share))
    failed = results.filter(pl.col("section") == "failed")
    lines += ["", *(f"failed: {r['case']}, {r['method']}: {r['name']}" for r in failed.to_dicts())]
    lines += [f"{len(failed)} fits failed", ""]
    lines += ["Mean error of least squares over those of the tracks, and the chain's best step"]
    for cell in cells:
        yaps, ls, *steps = _theirs(cell)
        chain = {m: mean[*cell, m] for m in methods if m.startswith(f"{base}-")}
        best = min(chain, key=lambda m: chain[m]).removeprefix(f"{base}-")
        named = dict(zip(steps, theirs[2:], strict=True))
        line = f"{cell[0]:.2f} / {cell[1]:.2f}".rjust(12)
        over_toa, over_yaps = (mean[*cell, base] / mean[*cell, m] for m in ("toa", "yaps"))
        line += f"   toa {over_toa:6.2f}   yaps {over_yaps:6.2f} (thesis {ls / yaps:6.2f})"
        lines.append(line + f"   {best:9} (thesis {named[min(steps)]})")
    return "\n".join(lines)


def _theirs(cell: tuple[float, float]) -> tuple[float, ...]:
    """The thesis's mean errors: YAPS, LS, outlier filter, KF, RTSS; NaN where it has no cell."""
    at = round(cell[0], 2), round(cell[1], 2)
    if at not in TABLE_C1:
        return (float("nan"),) * 5
    row, steps = TABLE_C1[at], STEPS_C1[at]
    return row.yaps, row.ls, steps.outlier, steps.kf, row.chain


def _shares(text: str) -> tuple[float, ...]:
    return tuple(float(part) for part in text.split(","))


def main(argv: list[str] | None = None) -> int:
    """Command line; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tracks", type=int, default=2, help="in every cell")
    parser.add_argument("--missing", type=_shares, default=(0.0, 0.2, 0.3, 0.5), metavar="P,P")
    parser.add_argument("--late", type=_shares, default=(0.0, 0.06, 0.15), metavar="P,P")
    parser.add_argument("--base", choices=("ls", "de"), default="ls", help="de: as the thesis")
    parser.add_argument("--box", action="store_true", help="fish roam 60 m around the array")
    parser.add_argument("--receivers", type=Path, help="table of other receivers in the canal")
    parser.add_argument("--noise", choices=("gaussian", "poisson"), default="gaussian")
    parser.add_argument("--pings", type=int, default=250)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("thesis_table"), help="gone on with")
    parser.add_argument("--quiet", action="store_true")
    given = parser.parse_args(argv)
    sd = 0.0 if given.noise == "poisson" else CanalDesign.sd
    design = CanalDesign(given.pings, noise=given.noise, sd=sd, in_water=not given.box)
    methods = tuple(name.format(base=given.base) for name in OURS)
    try:
        found = run_canal(
            Settings(design, given.seed, receivers=given.receivers),
            own_cases(given.tracks, given.missing, given.late),
            methods, given.out, workers=given.workers, quiet=given.quiet,
        )  # fmt: skip
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    print(tables(found, given.base))
    return 0


if __name__ == "__main__":
    sys.exit(main())
