"""Tables of the study, with the paper's values beside: means over data sets, standard errors.

Distances are pooled over all positions of all data sets; their standard errors take each data set
as one unit (positions within one are not independent).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    import polars as pl

__all__ = ["PAPER_BIAS", "PAPER_TABLE2", "Estimate", "pooled", "ratio", "report"]

LABELS = {
    "independent": "Ind. loc",
    "detection_only": "Mvmt DO",
    "known_interval": "Mvmt KI",
    "unknown_interval": "Mvmt UI",
}
# Hostetter & Royle (2020), Table 1: relative bias
PAPER_BIAS = {
    "independent": {"scale": 0.06, "p0": 0.11},
    "detection_only": {"sigma_step": -0.09, "scale": -0.01, "p0": 0.16},
    "known_interval": {"sigma_step": 0.00, "scale": 0.00, "p0": -0.01},
    "unknown_interval": {"sigma_step": -0.08, "scale": 0.00, "p0": -0.01},
}
# Table 2: number of detections -> mean distance, "Prec", "Cov"
PAPER_TABLE2 = {
    "independent": dict(
        enumerate(
            [
                (0.89, 1.30, 0.96),
                (0.63, 0.91, 0.96),
                (0.51, 0.74, 0.96),
                (0.45, 0.65, 0.96),
                (0.40, 0.58, 0.96),
                (0.37, 0.53, 0.96),
            ],
            1,
        )
    ),
    "detection_only": dict(
        enumerate(
            [
                (0.49, 0.63, 0.88),
                (0.37, 0.50, 0.92),
                (0.33, 0.45, 0.93),
                (0.30, 0.42, 0.93),
                (0.29, 0.40, 0.94),
                (0.26, 0.37, 0.93),
            ],
            1,
        )
    ),
    "known_interval": dict(
        enumerate(
            [
                (0.72, 1.00, 0.94),
                (0.42, 0.60, 0.95),
                (0.36, 0.51, 0.95),
                (0.33, 0.46, 0.95),
                (0.31, 0.43, 0.95),
                (0.29, 0.41, 0.95),
                (0.26, 0.38, 0.93),
            ]
        )
    ),
    "unknown_interval": dict(
        enumerate(
            [
                (0.55, 0.74, 0.92),
                (0.46, 0.63, 0.93),
                (0.42, 0.58, 0.94),
                (0.39, 0.54, 0.94),
                (0.38, 0.52, 0.92),
                (0.36, 0.49, 0.94),
            ],
            1,
        )
    ),
}
PAPER_MISSED = 0.02
SYMBOLS = {"sigma_step": "sigma_u", "scale": "sigma_det", "p0": "p0"}


class Estimate(NamedTuple):
    """A value and its standard error over data sets (NaN with one data set)."""

    value: float
    se: float


def ratio(above: np.ndarray, below: np.ndarray) -> Estimate:
    """Ratio of two totals over data sets (G,), with its linearised standard error.

    Cochran (1977) Sampling Techniques, section 6.4: data sets are drawn independently, what is in
    one belongs together.
    """
    above, below = np.asarray(above, float), np.asarray(below, float)
    g, total = len(above), below.sum()
    if not total > 0:
        return Estimate(float("nan"), float("nan"))
    value = above.sum() / total
    if g < 2:
        return Estimate(float(value), float("nan"))
    off = above - value * below
    return Estimate(float(value), float(np.sqrt(g / (g - 1) * np.sum(off**2)) / total))


def pooled(table: pl.DataFrame, column: str) -> Estimate:
    """Mean of a column over all rows, its standard error from `ratio` over data sets."""
    import polars as pl

    total = (
        table.group_by("dataset").agg(pl.col(column).cast(float).sum(), pl.len()).sort("dataset")
    )
    return ratio(total[column].to_numpy(), total["len"].to_numpy())


def report(results: pl.DataFrame) -> str:
    """Everything that the study says, as text.

    Parameters
    ----------
    results : DataFrame
        What `maloc.studies.hostetter_royle.study.run_study` returns.
    """
    import polars as pl

    def section(name: str) -> pl.DataFrame:
        return results.filter(pl.col("section") == name)

    models = [m for m in LABELS if m in set(results["model"])]
    lines = [f"{results['dataset'].n_unique()} simulated data sets; standard errors over them", ""]
    if (failed := section("failed")).height:
        lines += [f"{failed.height} fits failed, and are in no table:"]
        lines += [
            f"  data set {r['dataset']}, {r['model']}: {r['name']}" for r in failed.to_dicts()
        ]
    if "position" in set(results["section"]):
        lines += [*_table1(section("parameter"), models), "", *_table2(section("position"), models)]
        lines += _compared(section("position"))
        lines += _missed(section("gap"))
        lines += ["", *_effort(section("parameter"), section("run"), section("warning"), models)]
    return "\n".join(lines)


def _table1(parameters: pl.DataFrame, models: list[str]) -> list[str]:
    import polars as pl

    lines = ["Table 1: posterior means and their relative bias (paper's beside)"]
    lines += [f"{'':10}{'':10}{'true':>7}{'mean':>9}{'se':>8}{'bias':>9}{'se':>8}{'paper':>8}"]
    for model in models:
        for name, symbol in SYMBOLS.items():
            rows = parameters.filter((pl.col("model") == model) & (pl.col("name") == name))
            if not rows.height:
                continue
            mean, true = pooled(rows, "mean"), float(rows["true"][0])
            bias, se = mean.value / true - 1, mean.se / true
            line = f"{LABELS[model]:10}{symbol:10}{true:>7.3f}{mean.value:>9.4f}{mean.se:>8.4f}"
            line += f"{bias:>+9.3f}{se:>8.3f}{PAPER_BIAS[model][name]:>+8.2f}"
            lines.append(line)
    return lines


def _table2(positions: pl.DataFrame, models: list[str]) -> list[str]:
    import polars as pl

    lines = ["Table 2: by number of detections, the paper's value in brackets"]
    lines += [
        "dist: posterior mean to truth; prec: mean over draws; 95 % sets: highest density of a"
    ]
    lines += ["two-dimensional kernel, and the ellipse that holds 95 % of the draws"]
    lines += [
        f"{'':10}{'det':>4}{'n':>8}{'dist':>8}{'se':>7}{'':8}{'prec':>7}{'se':>7}{'':8}"
        f"{'kernel':>7}{'se':>7}{'':8}{'ellipse':>8}{'se':>7}"
    ]
    for model in models:
        for k in range(7):  # 7 and 8 are rare; the paper leaves them out
            rows = positions.filter((pl.col("model") == model) & (pl.col("detections") == k))
            if not rows.height:
                continue
            paper = PAPER_TABLE2[model].get(k, (np.nan,) * 3)
            line = f"{LABELS[model]:10}{k:>4}{rows.height:>8}"
            for i, name in enumerate(("distance", "precision", "kernel")):
                value, se = pooled(rows, name)
                line += f"{value:>{8 - (i > 0)}.3f}{se:>7.3f}  ({paper[i]:.2f})"
            value, se = pooled(rows, "ellipse")
            lines.append(f"{line}{value:>8.3f}{se:>7.3f}")
        heard = positions.filter((pl.col("model") == model) & pl.col("detections").is_between(1, 6))
        if heard.height:
            kernel, ellipse = pooled(heard, "kernel"), pooled(heard, "ellipse")
            lines.append(
                f"{LABELS[model]:10} 1-6{heard.height:>8}{'':45}{kernel.value:>7.3f}"
                f"{kernel.se:>7.3f}{'':8}{ellipse.value:>8.3f}{ellipse.se:>7.3f}"
            )
    return lines


def _compared(positions: pl.DataFrame) -> list[str]:
    """Unknown against known interval, on pings of data sets that have both."""
    import polars as pl

    keys = ["dataset", "tag", "time", "detections"]
    known, unknown = (
        positions.filter(pl.col("model") == m).select(*keys, pl.col("distance").alias(m))
        for m in ("known_interval", "unknown_interval")
    )
    both = known.join(unknown, on=keys)
    if not both.height:
        return []
    lines = ["", "Unknown over known interval, mean distances of the same pings"]
    lines += [f"{'det':>4}{'n':>8}{'known':>8}{'unknown':>9}{'ratio':>8}{'se':>8}"]
    for k in range(1, 7):
        rows = both.filter(pl.col("detections") == k)
        if not rows.height:
            continue
        total = rows.group_by("dataset").agg(pl.col("known_interval", "unknown_interval").sum())
        found = ratio(*(total[m].to_numpy() for m in ("unknown_interval", "known_interval")))
        a, b = rows["known_interval"].mean(), rows["unknown_interval"].mean()
        lines.append(f"{k:>4}{rows.height:>8}{a:>8.3f}{b:>9.3f}{found.value:>8.3f}{found.se:>8.3f}")
    return lines


def _missed(gaps: pl.DataFrame) -> list[str]:
    import polars as pl

    if not gaps.height:
        return []
    lines = ["", f"Missed pings (paper: relative bias {PAPER_MISSED:+.2f})"]
    for what, rows in (
        ("between a tag's first and last heard ping", gaps.filter(pl.col("name") == "inside")),
        ("leads before and after included", gaps),
    ):
        if not rows["true"].sum() > 0:
            continue
        total = rows.group_by("dataset").agg(pl.col("true", "mean").sum())
        found = ratio(total["mean"].to_numpy(), total["true"].to_numpy())
        tags = rows.group_by("dataset", "tag").agg(pl.col("true", "mean").sum())
        off = np.sqrt(np.mean((tags["mean"] - tags["true"]).to_numpy() ** 2))
        lines.append(
            f"  {what}: {rows['true'].sum():.0f} true, relative bias {found.value - 1:+.4f} "
            f"(se {found.se:.4f}), root mean square error a tag {off:.2f}"
        )
    for what, rows in (("gaps", gaps), ("gaps whose count is open", gaps.filter(~pl.col("sure")))):
        if rows.height:
            value, se = pooled(rows, "covered")
            share = f"{value:.3f} (se {se:.3f}) of {rows.height} {what}"
            lines.append(f"  90 % sets of n hold the truth in {share}")
    return lines


def _effort(
    parameters: pl.DataFrame, run: pl.DataFrame, warning: pl.DataFrame, models: list[str]
) -> list[str]:
    """What the fits cost, and how well they went."""
    import polars as pl

    lines = ["Effective draws (bulk) a CPU second after warm-up; medians over data sets"]
    names = list(SYMBOLS)
    lines += [
        f"{'':10}{'worst':>8}" + "".join(f"{SYMBOLS[n]:>10}" for n in names) + f"{'CPU s':>8}"
        f"{'steps':>7}{'diverg.':>9}{'R-hat':>7}{'of places':>11}{'warned':>8}"
    ]
    for model in models:
        mine = parameters.filter(pl.col("model") == model)
        if not mine.height:
            continue
        runs = run.filter(pl.col("model") == model)
        wide = runs.pivot("name", index="dataset", values="mean")
        speed = mine.join(wide, on="dataset").with_columns(
            (pl.col("ess") / pl.col("cpu_after_warmup")).alias("speed")
        )
        worst = speed.group_by("dataset").agg(pl.col("speed").min())["speed"].median()
        line = f"{LABELS[model]:10}{worst:>8.2f}"
        for name in names:
            one = speed.filter(pl.col("name") == name)["speed"]
            line += f"{one.median():>10.2f}" if len(one) else f"{'-':>10}"
        line += f"{wide['cpu'].median():>8.0f}{wide['steps'].median():>7.1f}"
        line += f"{wide['divergences'].sum():>9.0f}{mine['r_hat'].max():>7.3f}"
        warned = warning.filter(pl.col("model") == model)["dataset"].n_unique()
        line += f"{wide['r_hat_position'].max():>11.3f}{warned:>8}"
        lines.append(line)
    lines += ["CPU s: whole fit, compilation included; R-hat: largest of parameters, of positions"]
    return lines
