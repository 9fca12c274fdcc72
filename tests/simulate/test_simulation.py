"""A whole simulated study: raw data, true clock and truth agree, and survive being written."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest

from maloc.data import Schedule
from maloc.errors import InputError
from maloc.readers import read_detections, read_receivers, read_toa
from maloc.simulate import SCENARIOS, Hearing, canal_toa, simulate
from maloc.simulate.animals import in_polygon
from maloc.simulate.arrays import canal
from maloc.simulate.simulation import ORIGIN


@pytest.mark.parametrize("scenario", sorted(SCENARIOS))
def test_raw_detections_are_arrival_times_through_the_clocks(scenario):
    """Undo clocks and geometry from the truth alone: milliseconds of noise must be left."""
    sim = simulate(np.random.default_rng(1), scenario, 60, hearing=Hearing(p_mp=0.0))
    index = {name: j for j, name in enumerate(sim.receivers.names)}
    worst = 0.0
    count = 0
    for time, name, tag in zip(
        sim.detections.time, sim.detections.receiver, sim.detections.tag, strict=True
    ):
        if tag != sim.toa.tag:
            continue
        j = index[name]
        local = (int(time) - ORIGIN) * 1e-9
        true = local - np.interp(local, sim.clocks.knots, sim.clocks.ahead[:, j])
        distance = np.hypot(sim.truth.x - sim.receivers.x[j], sim.truth.y - sim.receivers.y[j])
        worst = max(worst, np.abs(sim.truth.time + distance / 1450.0 - true).min())
        count += 1
    assert count == sim.toa.heard.sum() == sim.truth.n_heard.sum()
    assert 1e-4 < worst < 8e-3  # Poisson(1) ms is hardly ever above 7


def test_drift_is_in_the_raw_times():
    """Same seed with and without clocks' errors: the difference is the clocks' error."""
    quiet = {"offset_sd": 0.0, "drift_ppm": 50.0, "hearing": Hearing(0.0, p_mp=0.0, resolution=0)}
    sim = simulate(np.random.default_rng(7), "grid", 100, **quiet)
    raw = (sim.detections.time[sim.toa.detection] - ORIGIN) * 1e-9
    gained = raw - sim.toa.toa
    for j in range(len(sim.receivers)):
        want = np.interp(sim.toa.toa[:, j], sim.clocks.knots, sim.clocks.ahead[:, j])
        np.testing.assert_allclose(gained[:, j], want, atol=1e-6)
    assert np.abs(gained).max() > 0.01 and np.abs(gained[:, 0]).max() < 1e-8


def test_sync_tags_sit_on_receivers_and_are_heard_there():
    sim = simulate(np.random.default_rng(2), "grid", 40, sync_every=3)
    tags = [t for t in sim.receivers.sync_tag if t]
    assert len(tags) == 6 and set(sim.detections.tags) == {sim.toa.tag, *tags}
    none = simulate(np.random.default_rng(2), "grid", 40, sync_every=0)
    assert none.detections.tags == (none.toa.tag,)


def test_rows_point_at_the_detection_of_that_receiver():
    sim = simulate(np.random.default_rng(3), "line", 50)
    assert sim.toa.detection is not None
    ping, column = np.nonzero(sim.toa.heard)
    row = sim.toa.detection[ping, column]
    assert (sim.detections.receiver[row] == sim.receivers.receiver[column]).all()
    assert (sim.detections.tag[row] == sim.toa.tag).all() and len(set(row)) == len(row)
    assert (sim.toa.detection[~sim.toa.heard] == -1).all()


def test_same_seed_same_study_and_other_seed_another():
    a, b, c = (simulate(np.random.default_rng(s), "canal", 30) for s in (5, 5, 6))
    assert (a.detections.time == b.detections.time).all()
    assert not np.array_equal(a.truth.x, c.truth.x)


def test_written_tables_are_read_back(tmp_path):
    sim = simulate(np.random.default_rng(1), "canal", 40, schedule=Schedule("stable", 30.0, 0.1))
    out = sim.write(tmp_path / "study")
    names = {"detections.csv", "receivers.csv", "toa.csv", "truth.csv", "clocks.csv"}
    assert {p.name for p in out.iterdir()} == names | {"summary.json"}
    detections, receivers = (
        read_detections(out / "detections.csv"),
        read_receivers(out / "receivers.csv"),
    )
    assert (detections.time == sim.detections.time).all()
    assert (detections.receiver == sim.detections.receiver).all()
    np.testing.assert_allclose(receivers.xy, sim.receivers.xy)
    assert (receivers.sync_tag == sim.receivers.sync_tag).all()
    toa = read_toa(out / "toa.csv", receivers)
    np.testing.assert_allclose(toa.toa, sim.toa.toa, atol=1e-9)
    with (out / "truth.csv").open() as f:
        truth = list(csv.DictReader(f))
    np.testing.assert_allclose([float(r["t"]) for r in truth], sim.truth.time)
    stamps = np.array([r["time"].rstrip("Z") for r in truth], "datetime64[ns]").astype(np.int64)
    assert np.abs((stamps - ORIGIN) * 1e-9 - sim.truth.time).max() < 2e-6
    assert json.loads((out / "summary.json").read_text())["options"]["schedule"]["lo"] == 30.0
    with pytest.raises(InputError, match="exists"):
        sim.write(out)
    sim.write(out, force=True)


def test_canal_stays_in_the_water_and_roams_when_asked():
    water = canal().water
    assert water is not None
    toa, truth = canal_toa(np.random.default_rng(0), 250, 0.5, 0.15, margin=None)
    assert in_polygon(np.stack([truth.x, truth.y], 1), water).all()
    assert toa.heard.mean() == pytest.approx(0.5, abs=0.05)
    outside = 0
    for seed in range(4):
        _, truth = canal_toa(np.random.default_rng(seed))
        outside += (~in_polygon(np.stack([truth.x, truth.y], 1), water)).sum()
    assert outside > 100
    # The speeds of the published tracks: a median near .14 m/s between pings.
    speed = np.hypot(np.diff(truth.x), np.diff(truth.y)) / np.diff(truth.time)
    assert 0.11 < np.median(speed) < 0.18


def test_unknown_scenario_and_no_pings_are_refused():
    with pytest.raises(InputError, match="grid"):
        simulate(np.random.default_rng(0), "ocean")
    with pytest.raises(InputError, match="pings"):
        simulate(np.random.default_rng(0), "grid", 0)
