"""Small data under the names that pages use: what a page takes for granted before its code."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

import maloc
from maloc.simulate import Hearing, simulate

SERIALS = [str(128367 + 2 * i) for i in range(12)]  # as a maker numbers its receivers
TAG = "A69-1602-15266"


@cache
def study() -> tuple[Any, Any, np.ndarray]:
    """Detections, receivers and the true positions of one animal in a canal."""
    how: dict[str, Any] = {"schedule": maloc.Schedule("random", 20.0, 40.0)}
    found = simulate(np.random.default_rng(1), "canal", n_pings=60, **how)
    serial = dict(zip(map(str, found.receivers.receiver), SERIALS, strict=True))
    heard = found.detections.to_frame().with_columns(
        pl.col("receiver").replace_strict(serial),
        pl.col("tag").str.replace("A69-1602-1001", TAG, literal=True),
    )
    array = found.receivers.to_frame().with_columns(pl.col("receiver").replace_strict(serial))
    truth = np.column_stack([found.truth.x, found.truth.y])
    return maloc.Detections.from_frame(heard), maloc.read_receivers(array), truth


@cache
def clocks() -> Any:
    """Return the receivers' clocks."""
    return maloc.sync.fit(*study()[:2], progress=False)


@cache
def arrivals() -> Any:
    """Return the animal's arrival times."""
    interval = maloc.Schedule("random", 20.0, 40.0)
    return maloc.toa_matrix(clocks().apply(study()[0]), study()[1], tag=TAG, schedule=interval)


@cache
def fitted() -> Any:
    """Return the animal's track."""
    return maloc.infer.laplace(maloc.models.toa_track, arrivals())


def names(page: str, folder: Path) -> dict[str, Any]:
    """Return what a page's code may use, and put the files that it reads into `folder`."""
    prepare = PAGES.get(page)
    return {"maloc": maloc, "np": np} | ({} if prepare is None else prepare(folder))


def _export(folder: Path) -> dict[str, Any]:
    """An export as VUE writes it, and the table of receivers."""
    detections, receivers, _ = study()
    columns = {
        "Date and Time (UTC)": pl.col("time").dt.strftime("%Y-%m-%d %H:%M:%S%.6f"),
        "Receiver": pl.format("VR2W-{}", "receiver"),
        "Transmitter": "tag",
    }
    detections.to_frame().select(**columns).write_csv(folder / "VUE_Export.csv")
    receivers.to_frame().write_csv(folder / "receivers.csv")
    return {}


def _fit(folder: Path) -> dict[str, Any]:
    return {"fit": fitted(), "toa": arrivals(), "receivers": study()[1]}


def _run(folder: Path) -> dict[str, Any]:
    """A finished `maloc track` in the folder ``track``."""
    from typer.testing import CliRunner

    from maloc.cli import app

    _export(folder)
    table = ["track", str(folder / "VUE_Export.csv"), "--receivers", str(folder / "receivers.csv")]
    how = ["--tag", "15266", "--interval", "20", "40", "--out", str(folder / "track"), "--quiet"]
    done = CliRunner().invoke(app, table + how)
    assert done.exit_code == 0, done.output
    return _fit(folder)


def _after(folder: Path) -> dict[str, Any]:
    low, high = study()[2].min(axis=0), study()[2].mean(axis=0)
    corners = np.array([low, (high[0], low[1]), high, (low[0], high[1])])
    times = np.linspace(arrivals().first[0], arrivals().first[-1], 50)
    return _run(folder) | {"times": times, "corners": corners}


def _sync(folder: Path) -> dict[str, Any]:
    detections, receivers, _ = study()
    recorded = detections.time[:1]
    names = {"detections": detections, "receivers": receivers}
    return names | {"recorded": recorded, "true": recorded + 250_000_000}


def _presence(folder: Path) -> dict[str, Any]:
    """Whole seconds, a tag that pings every one to two minutes, a dozen tags at known places."""
    hearing = Hearing(p_na=0.1, scale=60.0)
    how: dict[str, Any] = {"hearing": hearing, "schedule": maloc.Schedule("random", 60.0, 120.0)}
    found = simulate(np.random.default_rng(2), "grid", n_pings=40, sync_every=0, **how)
    coarse = found.detections.to_frame().with_columns(pl.col("time").dt.truncate("1s"))
    rng = np.random.default_rng(3)
    low, high = found.receivers.xy.min(axis=0), found.receivers.xy.max(axis=0)
    sent_from = rng.uniform(low, high, (200, 2))
    distance = np.linalg.norm(sent_from[:, None] - found.receivers.xy, axis=-1)
    return {
        "detections": maloc.Detections.from_frame(coarse),
        "receivers": found.receivers,
        "tag": found.toa.tag,
        "rng": rng,
        "sent_from": sent_from,
        "distance": distance,
    }


def _classical(folder: Path) -> dict[str, Any]:
    """The animal's pings, and two sync tags whose places are known."""
    from maloc.classical import FixedTags
    from maloc.points import locate

    detections, receivers, _ = study()
    common = clocks().apply(detections)
    with_tag = [i for i, tag in enumerate(receivers.sync_tag) if tag][:2]
    fixed = [maloc.toa_matrix(common, receivers, tag=receivers.sync_tag[i]) for i in with_tag]
    points = locate(fixed[0])
    error = FixedTags.of([points], [tuple(receivers.xy[with_tag[0]])]).error
    names = {"toa_of_r1": fixed[0], "toa_of_r2": fixed[1]}
    return names | {"toa": arrivals(), "fixed_points": points, "fixed_error": error}


def _depth(folder: Path) -> dict[str, Any]:
    """A tag that says its depth, receivers moored at two depths."""
    detections, receivers, _ = study()
    heard = detections.to_frame().with_columns(
        pl.col("tag").replace(TAG, "A69-1602-7"), depth=pl.lit(12.0)
    )
    deep = [5.0, 35.0] * 6
    array = receivers.to_frame().with_columns(depth=pl.Series(deep))
    array = maloc.read_receivers(array)
    tag = pl.col("tag").replace("A69-1602-7", "pike")
    return {
        "detections": clocks().apply(maloc.Detections.from_frame(heard.with_columns(tag))),
        "receivers": array,
    }


def _emitters(folder: Path) -> dict[str, Any]:
    """Five scans of one emitter that calls from four receivers' midst, and a shared code."""
    from maloc.data import prepare
    from maloc.emitters import CodeDesign, simulate_code

    xy = np.array([[0.0, 0.0], [400.0, 0.0], [400.0, 400.0], [0.0, 400.0]])
    scans = []
    for k in range(5):
        away = np.linalg.norm(xy - (150.0 + k, 210.0), axis=1)
        scans.append((10.0 * k, 10.0 * k + away / 1480.0, np.arange(4)))
    design = CodeDesign(hours=1.0)
    scene = simulate_code(np.random.default_rng(5), design)
    tag = scene.detections.tags[0]
    limits = {tag: (design.schedule.lo, design.schedule.hi)}
    kept = prepare(scene.detections, scene.receivers, limits).kept
    return {"xy": xy, "scans": scans, "kept": kept, "receivers": scene.receivers, "tag": tag}


def _tags(folder: Path) -> dict[str, Any]:
    """Three short tracks."""
    from maloc.simulate import canal_toa

    found = [canal_toa(np.random.default_rng(i), n_pings=30)[0] for i in range(3)]
    return {"toas": [toa.replace(tag=f"A69-1602-{i}") for i, toa in enumerate(found)]}


def _logger(folder: Path) -> dict[str, Any]:
    text = "unit;utc;code\n7;01/05/2026 12:00:00.125;15266\n8;01/05/2026 12:00:00.250;15266\n"
    (folder / "logger.txt").write_text(text)
    return {}


PAGES = {
    "README.md": _export,
    "docs/add_format.md": _logger,
    "docs/after.md": _after,
    "docs/checks.md": _fit,
    "docs/classical.md": _classical,
    "docs/decisions/why_datatree.md": _run,
    "docs/depth.md": _depth,
    "docs/emitters.md": _emitters,
    "docs/points.md": _fit,
    "docs/presence.md": _presence,
    "docs/posterior.md": _run,
    "docs/sync.md": _sync,
    "docs/tags.md": _tags,
}
