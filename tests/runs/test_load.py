"""From files to arrival times: what reading is told, and what the burst interval rules out."""

import csv
from typing import Any

import numpy as np
import pytest

from maloc.errors import InputError
from maloc.runs.load import load
from maloc.runs.log import Log
from maloc.runs.options import TrackOptions
from maloc.runs.reading import Reading

NS = 1_000_000_000
T0 = 1_622_548_800 * NS
XY = np.array([[0.0, 0.0], [300.0, 0.0], [300.0, 250.0], [0.0, 250.0]])


@pytest.fixture
def study(tmp_path):
    """Two codes of one animal, alternating, at four receivers; and a false detection."""
    rng = np.random.default_rng(4)
    sent = np.cumsum(rng.uniform(20, 40, 30))
    at = np.column_stack([100 + 2.0 * np.arange(30), 80 + 1.5 * np.arange(30)])
    heard = []
    for k, (t, place) in enumerate(zip(sent, at, strict=True)):
        arrival = t + np.hypot(*(XY - place).T) / 1500.0
        heard += [(a, j, f"A69-9006-50{k % 2}", k % 2 and 4.0 or 2.0 * k)
                  for j, a in enumerate(arrival)]  # fmt: skip
    heard.append((heard[60][0] + 7.0, 0, "A69-9006-501", 4.0))
    with open(tmp_path / "d.csv", "w") as f:
        out = csv.writer(f)
        out.writerow(["time_local", "receiver", "tag", "sensor"])
        for t, j, tag, value in heard:
            stamp = str(np.datetime64(T0 + round(t * NS), "ns"))
            out.writerow([stamp, f"R{j}", tag, value])
    (tmp_path / "r.csv").write_text(
        "receiver,x,y\n" + "".join(f"R{j},{x},{y}\n" for j, (x, y) in enumerate(XY))
    )
    (tmp_path / "tags.csv").write_text(
        "tag,animal,sensor,slope,intercept,min_delay,max_delay\n"
        "A69-9006-500,pike,depth,0.5,1,20,40\nA69-9006-501,pike,temperature,1,0,20,40\n"
    )
    return tmp_path


def options(folder, **more: Any):
    zone, tags = more.pop("tz", "Etc/GMT-2"), more.pop("tags", folder / "tags.csv")
    given: dict[str, Any] = {
        "detections": (folder / "d.csv",),
        "receivers": folder / "r.csv",
        "reading": Reading(None, zone, None, tags),
        "sync": "none",
        "sound_speed": "1500",
    }
    return TrackOptions(**given | more)


def test_one_track_of_two_codes_without_what_came_too_soon(study):
    source = load(options(study), Log(quiet=True))
    (toa,) = source.toas
    assert toa.tag == "pike" and toa.n_pings == 30 and toa.n_heard.tolist() == [4] * 30
    assert toa.origin is not None and 20 <= toa.origin / NS - (T0 / NS - 7200) <= 40
    assert toa.set_aside.detection.tolist() == [120]
    assert toa.set_aside.why.tolist() == ["7.000 s from another at R0, too soon for a ping"]
    assert toa.depth is not None
    np.testing.assert_allclose(toa.depth[::2], 1 + 0.5 * 2.0 * np.arange(0, 30, 2))
    assert np.isnan(toa.depth[1::2]).all()


def test_the_interval_of_the_command_line_goes_first(study):
    toa = load(options(study, interval=(5.0, 40.0)), Log(quiet=True)).toas[0]
    assert "too soon" not in " ".join(toa.set_aside.why)


def test_local_times_ask_for_their_zone(study):
    with pytest.raises(InputError, match="local time.*zone"):
        load(options(study, tz=None), Log(quiet=True))


def test_reading_options_are_for_detections():
    with pytest.raises(InputError, match="go with detections"):
        TrackOptions(toa="x.csv", reading=Reading(tz="UTC"))  # pyright: ignore


def test_who_heard_what_leaves_the_same_out_and_lists_it(study):
    from maloc.runs.load_encounters import load_encounters

    history = load_encounters(options(study, model="detections", sound_speed=None), Log(quiet=True))
    aside = history.history.set_aside
    assert 120 in aside.detection.tolist()
    assert aside.why[aside.detection == 120].tolist()[0].endswith("too soon for a ping")
