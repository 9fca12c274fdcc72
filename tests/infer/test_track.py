"""The track as a table: every ping once, in order, heard or not."""

import numpy as np
import pytest

import maloc.infer
from maloc.data import ArrivalTimes, Receivers, Schedule
from maloc.infer.track import gaps_outside, track_table
from maloc.models import toa_track
from tests.infer import cases

COLUMNS = (
    "tag time t x y sd_x sd_y cov_xy x_lo x_hi y_lo y_hi n_receivers heard ping".split()
)  # interface.md


def in_order(table):
    return (np.diff(table["t"].to_numpy()) > 0).all()


class TestHeard:
    def test_laplace(self, toa, laplace_fit):
        times, emission, _ = toa
        table = track_table(laplace_fit, times)
        assert table.columns == COLUMNS
        assert len(table) == 13
        assert in_order(table)
        assert table["heard"].to_list() == [True] * 4 + [False] + [True] * 8
        assert table["n_receivers"].to_list() == times.n_heard.tolist()
        assert table["ping"].to_list() == times.ping.tolist()
        assert table["tag"].unique().to_list() == ["A69-1602-1"]
        assert table["time"].null_count() == 13  # the data have no date
        heard = table.filter(table["heard"])
        mean, covariance = laplace_fit.moments()
        np.testing.assert_allclose(heard["x", "y"].to_numpy(), mean[:, :2])
        np.testing.assert_allclose(heard["sd_x"], np.sqrt(covariance[:, 0, 0]))
        np.testing.assert_allclose(heard["sd_y"], np.sqrt(covariance[:, 1, 1]))
        np.testing.assert_allclose(heard["cov_xy"], covariance[:, 0, 1])
        np.testing.assert_allclose(heard["x_hi"] - heard["x"], 1.959964 * heard["sd_x"], rtol=1e-6)
        np.testing.assert_allclose(heard["y"] - heard["y_lo"], 1.959964 * heard["sd_y"], rtol=1e-6)
        np.testing.assert_allclose(heard["t"], np.delete(emission, 4), atol=2e-3)

    def test_sampled(self, toa, sampled_fit):
        times, _, _ = toa
        table = track_table(sampled_fit, times)
        assert table.columns == COLUMNS
        heard = table.filter(table["heard"])
        draws = sampled_fit.draws()["position"].reshape(-1, 12, 2)
        np.testing.assert_allclose(heard["x", "y"].to_numpy(), draws.mean(0))
        np.testing.assert_allclose(heard["x_lo"], np.quantile(draws[:, :, 0], 0.025, axis=0))
        np.testing.assert_allclose(heard["y_hi"], np.quantile(draws[:, :, 1], 0.975, axis=0))

    def test_date_and_degrees(self, toa, laplace_fit):
        from dataclasses import replace

        times, emission, _ = toa
        origin = 1_700_000_000 * 10**9
        xy = times.receivers
        placed = replace(xy, x=xy.x + 500_000, y=xy.y + 5_000_000, crs="EPSG:32617")
        table = track_table(laplace_fit, times.replace(origin=origin, receivers=placed))
        assert table.columns == [*COLUMNS, "longitude", "latitude"]
        assert table["time"][0].startswith("2023-11-14T22:1")
        assert table["time"].null_count() == 0


class TestUnheard:
    def test_between(self, toa, laplace_fit):
        """A lost ping lies between its neighbours, less sure than they are, and holds the truth."""
        times, emission, position = toa
        table = track_table(laplace_fit, times)
        row, before, after = (table.row(i, named=True) for i in (4, 3, 5))
        assert before["t"] < row["t"] < after["t"]
        assert row["sd_x"] > max(before["sd_x"], after["sd_x"])
        assert row["x_lo"] < position[4, 0] < row["x_hi"]
        assert row["y_lo"] < position[4, 1] < row["y_hi"]
        assert row["n_receivers"] == 0
        assert row["x_lo"] < row["x"] < row["x_hi"]
        again = track_table(laplace_fit, times)
        assert table.equals(again)  # the seed is an argument
        assert not table.equals(track_table(laplace_fit, times, seed=1))

    @pytest.mark.parametrize("kind", ["unknown", "random", "stable"])
    def test_rows_that_nobody_heard(self, kind):
        """Two before the first, two after the last, one between: n rows come back."""
        lost = (0, 1, 5, 11, 12)
        times, emission, _ = cases.toa(kind=kind, unheard=lost)
        table = track_table(maloc.infer.laplace(toa_track, times), times)
        assert len(table) == 13
        assert in_order(table)
        assert np.flatnonzero(~table["heard"].to_numpy()).tolist() == list(lost)
        off = np.abs(table["t"].to_numpy() - emission)
        limit = {"unknown": 40.0, "random": 15.0, "stable": 0.3}[kind]
        assert off[list(lost)].max() < limit
        # the further from a heard ping, the less sure
        assert table["sd_x"][0] > table["sd_x"][1] > table["sd_x"][2]
        assert table["sd_x"][12] > table["sd_x"][11] > table["sd_x"][10]

    @pytest.mark.parametrize(("kind", "interval"), [("random", (20, 30)), ("stable", (25, 0.02))])
    def test_pings_that_only_the_schedule_knows_of(self, kind, interval):
        """Rows taken out of the input altogether are put back by the schedule."""
        times, emission, position = cases.toa(kind=kind, unheard=())
        keep = [i for i in range(13) if i not in (3, 8, 9)]
        fewer = times.replace(
            toa=times.toa[keep],
            sound_speed=times.sound_speed[keep],
            ping=None,
            schedule=Schedule(kind, *interval),
        )
        table = track_table(maloc.infer.laplace(toa_track, fewer), fewer)
        assert len(table) == 13
        assert in_order(table)
        assert np.flatnonzero(~table["heard"].to_numpy()).tolist() == [3, 8, 9]
        off = np.abs(table["t"].to_numpy() - emission)
        assert off.max() < (10.0 if kind == "random" else 0.3)
        lost = table.filter(~table["heard"])
        inside = (lost["x_lo"].to_numpy() < position[[3, 8, 9], 0]) & (
            position[[3, 8, 9], 0] < lost["x_hi"].to_numpy()
        )
        assert inside.all()

    def test_an_empty_row_that_the_schedule_has_no_room_for(self):
        """A burst interval's gap with an empty row in it: still a row, between its neighbours."""
        times, _, _ = cases.toa(kind="random", unheard=())
        more = times.replace(
            toa=np.insert(times.toa, 6, np.nan, axis=0),
            sound_speed=np.append(times.sound_speed, cases.SPEED),
            ping=None,
        )
        table = track_table(maloc.infer.laplace(toa_track, more), more)
        assert len(table) == 14
        assert in_order(table)
        assert not table["heard"][6]


def test_gaps_that_no_interval_explains_are_counted():
    receivers = Receivers(np.array(["a", "b", "c"]), np.array([0.0, 90, 0]), np.array([0.0, 0, 90]))
    first = np.cumsum([0.0, 5.4, 30, 61, 17, 119.9])  # 5.4 and 17 s are below the shortest
    times = ArrivalTimes(
        first[:, None] + np.array([0.0, 0.01, 0.02]), receivers, np.full(6, 1500.0)
    )
    assert gaps_outside(times) == 0
    assert gaps_outside(times.replace(schedule=Schedule("random", 20, 40))) == 2
    assert str(Schedule("random", 20, 40)) == "20 to 40 s"
