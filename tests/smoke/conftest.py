"""One small study, raw as receivers hand it out, and what `maloc` makes of it."""

from __future__ import annotations

from pathlib import Path

import polars as pl
import pytest

from tests.smoke.command import INTERVAL, TAGS, maloc


@pytest.fixture(scope="session")
def study(tmp_path_factory) -> Path:
    """Folder of a simulated study; a second tag goes with the first."""
    folder = tmp_path_factory.mktemp("smoke") / "study"
    maloc("simulate", folder, "--scenario", "canal", "--seed", 1, "--pings", 60, "--quiet")
    heard = pl.read_csv(folder / "detections.csv", infer_schema=False)
    tags = heard.filter(pl.col("tag") == TAGS[0])
    twin = tags.with_columns(pl.lit(TAGS[1]).alias("tag"))
    pl.concat([heard, twin]).write_csv(folder / "detections.csv")
    return folder


@pytest.fixture(scope="session")
def synced(study) -> Path:
    """Folder that `maloc sync` wrote."""
    out = study.parent / "sync"
    said = maloc(
        "sync", study / "detections.csv", "--receivers", study / "receivers.csv", "--out", out
    )
    assert "12 of 12 receivers" in said
    return out


@pytest.fixture(scope="session")
def tracked(study) -> Path:
    """Folder that `maloc track` wrote: the main job."""
    out = study.parent / "track"
    files = [study / "detections.csv", "--receivers", study / "receivers.csv"]
    how = ["--tag", "1001", "--interval", *INTERVAL, "--crs", "EPSG:32632"]
    maloc("track", *files, *how, "--out", out)
    return out


@pytest.fixture(scope="session")
def toa(study):
    """Arrival times, as the README makes them."""
    import maloc as package

    detections = package.read_detections(study / "detections.csv")
    receivers = package.read_receivers(study / "receivers.csv")
    sync = package.sync.fit(detections, receivers)
    return package.toa_matrix(
        sync.apply(detections),
        sync.receivers,
        tag=TAGS[0],
        schedule=package.Schedule("random", 20.6, 36.6),
    )


@pytest.fixture(scope="session")
def laplace(toa):
    """The fit of the README."""
    import maloc as package

    return package.infer.laplace(package.models.toa_track, toa)
