"""What a synchronisation is told in files, what it shows of its progress, and its interruption."""

import json
import time

import numpy as np
import polars as pl
import pytest
from typer.testing import CliRunner

from maloc import sync
from maloc.cli import app
from maloc.errors import InputError
from tests.sync.simulated import ORIGIN, simulate

TRUTH = simulate(5, n_receivers=4, hours=2.0)


def stamp(ns):
    return np.datetime_as_string(np.asarray(ns, "datetime64[ns]")).tolist()


@pytest.fixture
def moments():
    """Three detections by R002, which is hours off, at times that are truly known."""
    rows = np.flatnonzero((TRUTH.clock == 2) & ~TRUTH.late)[[3, 100, -4]]
    true = ORIGIN + np.round(TRUTH.true[rows] * 1e9).astype(np.int64)
    recorded = true + np.round(TRUTH.offset[rows] * 1e9).astype(np.int64)
    return recorded, true


@pytest.fixture
def study(tmp_path):
    d, r = TRUTH.detections, TRUTH.receivers
    pl.DataFrame({"time": stamp(d.time), "receiver": d.receiver, "tag": d.tag}).write_csv(
        tmp_path / "detections.csv"
    )
    columns = {"receiver": r.receiver, "x": r.x, "y": r.y, "sync_tag": r.sync_tag}
    pl.DataFrame(columns).write_csv(tmp_path / "receivers.csv")
    return tmp_path


def run(*args):
    return CliRunner().invoke(app, [str(a) for a in args])


def test_anchors_and_a_table_of_the_water_on_the_command_line(study, moments):
    recorded, true = moments
    table = pl.DataFrame({"receiver": ["R002"] * 3, "recorded": stamp(recorded)})
    table.with_columns(true=pl.Series(stamp(true))).write_csv(study / "anchors.csv")
    day = [stamp(ORIGIN - 10**12), stamp(ORIGIN + 10**14)]
    water = pl.DataFrame({"time": day, "sound_speed": [1480.0, 1480.0]})
    water.write_csv(study / "water.csv")
    args = [study / "detections.csv", "--receivers", study / "receivers.csv"]
    args += ["--anchors", study / "anchors.csv", "--sound-speed", study / "water.csv"]
    result = run("sync", *args, "--out", study / "out")
    assert result.exit_code == 0, result.output
    found = sync.ClockSync.from_netcdf(study / "out" / "sync.nc")
    direct = ~TRUTH.late
    offset = found.offset(TRUTH.detections.receiver, TRUTH.detections.time)
    # one line through three moments leaves R002's own swing and the millisecond of the times
    assert np.nanmax(np.abs((offset - TRUTH.offset)[direct])) < 0.01
    assert found.sound_speed == pytest.approx(1480.0)
    assert found.sound_speed_sd == 0
    summary = json.loads((study / "out" / "summary.json").read_text())
    assert any("3 moments of known true time" in n for n in summary["notices"])
    assert summary["options"]["anchors"].endswith("anchors.csv")


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("receiver,recorded\nR002,2020-09-13 12:00:00\n", "no column 'true'"),
        ("receiver,recorded,true\nR002,2020-09-13 12:00:00,\n", "a value is missing"),
        (
            "receiver,recorded,true\nR002,noon,2020-09-13 12:00:00\n",
            "line 2, column 'recorded': 'noon'",
        ),
    ],
)
def test_anchors_that_cannot_be_read(tmp_path, text, problem):
    (tmp_path / "anchors.csv").write_text(text)
    with pytest.raises(InputError, match=problem):
        sync.read_anchors(tmp_path / "anchors.csv")


def test_anchors_from_what_receivers_logged(tmp_path):
    """VUE's events: the computer's clock when a receiver was read out; none where there is none."""
    head = "Date and Time (UTC),Receiver,Description,Data,Units\n"
    other = "2021-06-02 09:00:00,VR2W-301001,Battery,3.4,V\n"
    path = tmp_path / "events.csv"
    path.write_text(f"{head}{other}2021-06-02 09:00:00,VR2W-301001,PC Time,2021-06-02 08:59:52,\n")
    found = sync.read_anchors(path)
    assert found.receiver.tolist() == ["301001"]
    assert (found.recorded - found.true).tolist() == [8 * 10**9]
    assert found.report.rows == 2 and found.report.files
    path.write_text(head + other)
    with pytest.raises(InputError, match="no moment of known true time"):
        sync.read_anchors(path)


def test_moments_of_others_are_counted(moments):
    fitted = sync.fit(TRUTH.detections, TRUTH.receivers)
    recorded, true = (np.r_[m, m[:1]] for m in moments)
    right = fitted.anchored(["R002"] * 3 + ["elsewhere"], recorded, true)
    assert "1 more are of no synchronised receiver" in right.notes[-1].text


def test_progress_is_told_and_an_interrupt_ends_it(study, monkeypatch):
    from maloc.sync import _fit

    told = []

    class Bar:
        def __init__(self, show):
            self.show = show

        def __enter__(self):
            return self

        def __exit__(self, *_):
            return False

        def __call__(self, stage):
            told.append((self.show, stage))
            if self.show and len(told) > 6:
                raise KeyboardInterrupt

    monkeypatch.setattr(_fit, "progress_bar", Bar)
    sync.fit(TRUTH.detections, TRUTH.receivers, progress=False)
    stages = [stage for _, stage in told]
    assert stages.count("aligning clocks") >= 3  # one a clock that is not the first
    assert sum(s.startswith("fitting 0 jumps and 3 clocks") for s in stages) > 3
    told.clear()
    args = [study / "detections.csv", "--receivers", study / "receivers.csv"]
    result = run("sync", *args, "--out", study / "out")
    assert result.exit_code == 130
    assert "interrupted" in result.output
    assert not (study / "out").exists()


def test_a_bar_that_takes_long_is_shown(capsys, monkeypatch):
    from maloc.sync import _progress

    monkeypatch.setattr(_progress, "PATIENCE", 0.0)
    for show in (True, False):
        with _progress.progress_bar(show) as tell:
            tell("aligning clocks")
            time.sleep(0.15)  # a bar is drawn ten times a second at most
            tell("fitting 2 jumps and 3 clocks")
        assert ("sync, fitting 2 jumps" in capsys.readouterr().err) is show
