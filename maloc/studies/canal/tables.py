"""Tables of the canal study: a row a method and cell, with the thesis's or a peer's errors beside.

Scores of positions are pooled over a cell's heard pings, scores of tracks are means over tracks;
standard errors take a track as one unit.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.errors import InputError
from maloc.evaluate.scores import deciles
from maloc.studies.canal.thesis import TABLE_C1, Thesis
from maloc.studies.hostetter_royle.tables import Estimate, ratio

if TYPE_CHECKING:
    import polars as pl

__all__ = ["mean_of", "read_peer", "report"]

_LOCAL, _CORRECT = 150.0, 2.5  # m: the thesis's local error and correct positions
_CELL = ("p_na", "p_mp")


def read_peer(path: Path) -> dict[str, float]:
    """A peer's mean errors (m) by file's stem: a CSV with columns file, mean."""
    import polars as pl

    if not path.exists():
        raise InputError("does not exist", file=path)
    table = pl.read_csv(path)
    if not {"file", "mean"} <= set(table.columns):
        raise InputError("has no columns file, mean", file=path)
    return dict(zip(table["file"].str.strip_suffix(".csv"), table["mean"], strict=True))


def mean_of(rows: pl.DataFrame, column: str = "error") -> Estimate:
    """Mean of a column over rows, with its standard error over tracks."""
    import polars as pl

    total = rows.group_by("track").agg(pl.col(column).sum(), pl.len()).sort("track")
    return ratio(total[column].to_numpy(), total["len"].to_numpy())


def report(results: pl.DataFrame, peer: dict[str, float] | None = None, own: bool = True) -> str:
    """Everything that the study says, as text.

    Parameters
    ----------
    results : DataFrame
        What `maloc.studies.canal.study.run_canal` returns.
    peer : dict, optional
        A peer's mean error (m) by case.
    own : bool
        The cases are simulated as the thesis's were, to be seen beside them.
    """
    import polars as pl

    methods = results["method"].unique(maintain_order=True).to_list()
    cases, tracks = results["case"].n_unique(), results["track"].n_unique()
    lines = [f"{cases} cases of {tracks} tracks; se: standard error over tracks", ""]
    failed = results.filter(pl.col("section") == "failed")
    lines += [f"failed: {r['case']}, {r['method']}: {r['name']}" for r in failed.to_dicts()]
    if "error" not in results.columns:
        return "\n".join(lines)
    every = results.filter(pl.col("section") == "position")
    heard = every.filter(pl.col("n_heard") > 0)
    lines += [*_errors(heard, results, methods, peer or {}, own), ""]
    lines += [*_tracks(heard, results, methods), ""]
    lines += _unheard(every.filter((pl.col("n_heard") == 0) & pl.col("error").is_finite()), methods)
    for other in methods[1:]:
        lines += [*_compared(every, methods[0], other), ""]
    lines += _calibration(heard, methods)
    return "\n".join(lines)


Cell = tuple[float, float] | None  # shares of missing and late arrivals; None: all cells


def _cells(table: pl.DataFrame, methods: list[str]) -> Iterator[tuple[str, Cell, pl.DataFrame]]:
    """Rows of each method and cell, then of each method and all its cells."""
    import polars as pl

    for method in methods:
        mine = table.filter(pl.col("method") == method)
        parts = mine.partition_by(*_CELL, as_dict=True)
        for p_na, p_mp in sorted(parts):
            yield method, (p_na, p_mp), parts[p_na, p_mp]
        if len(parts) > 1:
            yield method, None, mine


def _label(cell: Cell) -> str:
    if cell is None:
        return "all"
    return "-" if cell[0] < 0 else f"{cell[0]:.2f} / {cell[1]:.2f}"


def _thesis(cell: Cell) -> Thesis | None:
    return None if cell is None else TABLE_C1.get((round(cell[0], 2), round(cell[1], 2)))


def _errors(
    heard: pl.DataFrame, results: pl.DataFrame, methods: list[str], peer: dict, own: bool
) -> list[str]:
    import polars as pl

    lines = ["Errors of heard pings, m (local: within 150 m of the central receiver;"]
    lines += ["<2.5: share within 2.5 m; cover: of 95 % intervals; found: pings with a position)"]
    head = f"{'method':10}{'NA / MP':>12}{'fits':>7}{'failed':>7}{'found':>7}{'mean':>8}{'se':>7}"
    head += f"{'local':>8}{'median':>8}{'Q3':>8}{'<2.5':>7}{'cover':>7}"
    head += f"{'peer':>9}{'ratio':>7}" if peer else ""
    thesis = own and not peer
    lines += [head + (f"   thesis:{'YAPS':>6}{'LS':>7}{'chain':>7}" if thesis else "")]
    failures = results.filter(pl.col("section") == "failed")
    lost = {(m, c): len(r) for m, c, r in _cells(failures, methods)}
    means: dict[str, dict[Cell, float]] = {}
    for method, cell, rows in _cells(heard, methods):
        found = rows.filter(pl.col("error").is_finite())
        mean, se = mean_of(found)
        local = found.filter(pl.col("away") <= _LOCAL)["error"].mean()
        error = found["error"].to_numpy()
        line = f"{method:10}{_label(cell):>12}{rows['case'].n_unique():>7}"
        line += f"{lost.get((method, cell), 0):>7}"
        line += f"{len(found) / len(rows):>7.3f}{mean:>8.3f}{se:>7.3f}{_number(local):>8.3f}"
        line += f"{np.median(error):>8.3f}{np.quantile(error, 0.75):>8.3f}"
        line += f"{np.mean(error <= _CORRECT):>7.3f}{found['covered'].mean():>7.3f}"
        if peer:
            names = rows["case"].unique().to_list()
            other = np.mean([peer.get(name, np.nan) for name in names])
            line += f"{other:>9.3f}{mean / other:>7.3f}"
        if thesis and (t := _thesis(cell)):
            line += f"{'':10}{t.yaps:>6.2f}{t.ls:>7.2f}{t.chain:>7.2f}"
        lines.append(line)
        if cell is not None:
            means.setdefault(method, {})[cell] = mean
    return [*lines, *_degradation(means, thesis)]


def _number(value: Any) -> float:
    return float("nan") if value is None else float(value)


def _degradation(means: dict[str, dict[Cell, float]], thesis: bool) -> list[str]:
    """The last cell's mean error over the first's: most and fewest missing and late arrivals."""
    lines = []
    for method, cells in means.items():
        first, *_, last = list(cells) * 2
        if len(cells) > 1:
            grown = cells[last] / cells[first]
            line = f"{method}: mean error from {_label(first)} to {_label(last)}: x {grown:.2f}"
            a, b = _thesis(first), _thesis(last)
            if thesis and a and b:
                each = (y / x for x, y in zip(a, b, strict=True))
                line += " (thesis: YAPS {:.1f}, LS {:.0f}, chain {:.0f})".format(*each)
            lines.append(line)
    return lines


def _tracks(heard: pl.DataFrame, results: pl.DataFrame, methods: list[str]) -> list[str]:
    import polars as pl

    lines = ["Range and bearing seen from the central receiver; estimated track's length over the"]
    lines += ["true one's; true on predicted error: R2 of a line, rank correlation rho (means over"]
    lines += ["tracks); CPU s a track (the largest holds compilation); tracks with a warning"]
    lines += [
        f"{'method':10}{'NA / MP':>12}{'range m':>9}{'bearing deg':>12}{'length':>8}{'R2':>7}"
        f"{'rho':>7}{'CPU s':>8}{'largest':>9}{'warned':>8}"
    ]
    runs = results.filter(pl.col("section") == "run")
    wide = runs.pivot("name", index=["case", "track", *_CELL, "method"], values="value")
    warned = results.filter(pl.col("section") == "warning")
    warnings = {(m, c): r["case"].n_unique() for m, c, r in _cells(warned, methods)}
    by_cell = {(m, c): r for m, c, r in _cells(wide, methods)}
    for method, cell, rows in _cells(heard, methods):
        found, run = rows.filter(pl.col("error").is_finite()), by_cell[method, cell]
        line = f"{method:10}{_label(cell):>12}{found['range'].mean():>9.3f}"
        line += f"{found['bearing'].mean():>12.3f}"
        for name, width in (("length", 8), ("r2", 7), ("rho", 7)):
            line += f"{_number(run[name].fill_nan(None).mean()):>{width}.3f}"
        line += f"{run['cpu'].median():>8.2f}{run['cpu'].max():>9.2f}"
        lines.append(f"{line}{warnings.get((method, cell), 0):>8}")
    return lines


def _unheard(rows: pl.DataFrame, methods: list[str]) -> list[str]:
    """Pings that nobody heard, where a method says where they were."""
    lines = []
    for method, cell, mine in _cells(rows, methods):
        mean, se = mean_of(mine)
        cover = mine["covered"].mean()
        lines.append(
            f"{method:10}{_label(cell):>12}{len(mine):>9}{mean:>8.3f}{se:>7.3f}{cover:>7.3f}"
        )
    head = f"{'method':10}{'NA / MP':>12}{'pings':>9}{'mean':>8}{'se':>7}{'cover':>7}"
    return ["Pings that nobody heard", head, *lines, ""] if lines else []


def _compared(every: pl.DataFrame, first: str, other: str) -> list[str]:
    """Mean error of a method over that of the first, at pings that both located."""
    import polars as pl

    keys = ["case", "track", *_CELL, "ping", "n_heard"]
    a, b = (
        every.filter((pl.col("method") == m) & pl.col("error").is_finite()).select(
            *keys, pl.col("error").alias(name)
        )
        for m, name in ((first, "first"), (other, "other"))
    )
    both = a.join(b, on=keys, nulls_equal=True).with_columns(pl.lit(other).alias("method"))
    lines = [f"Mean error of {other} over that of {first}, at pings with both"]
    lines += [f"{'NA / MP':>12}{'heard':>9}{'se':>7}{'all pings':>11}{'se':>7}"]
    for _, cell, rows in _cells(both, [other]):
        line = f"{_label(cell):>12}"
        for width, part in ((9, rows.filter(pl.col("n_heard") > 0)), (11, rows)):
            total = part.group_by("track").agg(pl.col("first", "other").sum())
            value, se = ratio(total["other"].to_numpy(), total["first"].to_numpy())
            line += f"{value:>{width}.3f}{se:>7.3f}"
        lines.append(line)
    return lines


def _calibration(heard: pl.DataFrame, methods: list[str]) -> list[str]:
    """Predicted against true error over all cells, by decile of the predicted."""
    import polars as pl

    lines = ["Calibration over all cells: rms error over predicted rms, by decile of predicted"]
    for method in methods:
        rows = heard.filter(
            (pl.col("method") == method)
            & pl.col("error").is_finite()
            & pl.col("expected").is_finite()
        )
        if len(rows) < 10:
            continue
        each = deciles(rows["expected"].to_numpy(), rows["error"].to_numpy())
        lines.append(f"{method:10}" + "".join(f"{v:>7.3f}" for v in each))
    return lines
