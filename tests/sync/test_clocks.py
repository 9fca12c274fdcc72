import dataclasses

import numpy as np
import polars as pl
import pytest

from maloc import sync
from maloc.data import Detections
from maloc.errors import InputError
from maloc.readers import read_receivers
from maloc.runs.sync import write_sync
from maloc.sync import ClockSync
from tests.sync.simulated import ORIGIN, simulate

TRUTH = simulate(7, n_receivers=5, hours=3.0)


@pytest.fixture(scope="module")
def fitted():
    return sync.fit(TRUTH.detections, TRUTH.receivers, reference="R001")


def test_apply_is_the_offset_taken_off_to_the_nanosecond(fitted):
    d = TRUTH.detections
    common = fitted.apply(d)
    assert common.time.dtype == np.int64
    assert len(common) == len(d)
    offset = fitted.offset(d.receiver, d.time)
    np.testing.assert_allclose((d.time - common.time) * 1e-9, offset, atol=1e-8)
    reference = d.receiver == "R001"
    np.testing.assert_array_equal(common.time[reference], d.time[reference])
    np.testing.assert_array_equal(common.tag, d.tag)


def test_apply_keeps_the_other_columns_and_the_report(fitted):
    d = dataclasses.replace(TRUTH.detections, extra={"snr": np.arange(len(TRUTH.detections))})
    common = fitted.apply(d)
    np.testing.assert_array_equal(common.extra["snr"], d.extra["snr"])


def test_beyond_the_sync_detections(fitted):
    edge = fitted.span[2, 1] + fitted.values[2, -1]  # on the receiver's own clock
    after = fitted.origin + np.int64(1e9 * (edge + fitted.spacing * np.array([0.05, 0.95, 1.1])))
    d = Detections(after, np.array(["R002"] * 3), np.array(["A-1-5"] * 3))
    common = fitted.apply(d)
    assert len(common) == 2
    levels = {n.level: n for n in common.report.notes}
    assert levels["warning"].count == 1
    assert "set aside" in levels["warning"].text
    assert levels["info"].count == 2
    assert "carried on straight" in levels["info"].text
    # straight: the second difference of the offset vanishes
    t = after[0] + np.array([600, 1200, 1800]) * 10**9
    assert np.diff(fitted.offset("R002", t), 2) == pytest.approx(0.0, abs=1e-8)


def test_nothing_to_apply_to(fitted):
    assert len(fitted.apply(Detections.concat([]))) == 0


def test_netcdf_gives_the_same_back(fitted, tmp_path):
    path = tmp_path / "sync.nc"
    fitted.to_netcdf(path)
    back = ClockSync.from_netcdf(path)
    for f in dataclasses.fields(ClockSync):
        a, b = getattr(fitted, f.name), getattr(back, f.name)
        if isinstance(a, np.ndarray):
            np.testing.assert_array_equal(a, b)
        elif f.name in ("receivers", "residuals", "jumps"):
            for g in dataclasses.fields(a):
                if isinstance(getattr(a, g.name), np.ndarray):
                    np.testing.assert_array_equal(getattr(a, g.name), getattr(b, g.name))
        else:
            assert a == b, f.name
    np.testing.assert_array_equal(
        back.apply(TRUTH.detections).time, fitted.apply(TRUTH.detections).time
    )


def test_other_files_are_refused(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        ClockSync.from_netcdf(tmp_path / "none.nc")
    (tmp_path / "text.nc").write_text("no")
    with pytest.raises(InputError, match="not a NetCDF file"):
        ClockSync.from_netcdf(tmp_path / "text.nc")
    import xarray as xr

    xr.Dataset({"a": 1}).to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    with pytest.raises(InputError, match="not a synchronisation"):
        ClockSync.from_netcdf(tmp_path / "other.nc")


def test_write_makes_every_file_of_the_command(fitted, tmp_path):
    paths = write_sync(fitted, tmp_path, TRUTH.detections)
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(p.name for p in paths)
    assert {p.name for p in paths} == {
        "sync.nc",
        "detections_synced.parquet",
        "receivers_fitted.csv",
        "residuals.csv",
        "links.csv",
        "jumps.csv",
        "residuals.png",
        "clocks.png",
        "connectivity.png",
    }
    synced = Detections.from_frame(pl.read_parquet(tmp_path / "detections_synced.parquet"))
    np.testing.assert_array_equal(synced.time, fitted.apply(TRUTH.detections).time)
    table = read_receivers(tmp_path / "receivers_fitted.csv")
    np.testing.assert_allclose(table.xy, fitted.receivers.xy, atol=1e-5)
    np.testing.assert_array_equal(table.sync_tag, fitted.receivers.sync_tag)
    residuals = pl.read_csv(tmp_path / "residuals.csv")
    assert len(residuals) == len(fitted.residuals)
    assert residuals["used"].sum() == fitted.residuals.used.sum()
    assert residuals["time"][0].endswith("Z")


def test_links_count_every_sync_detection_once(fitted):
    links = fitted.links_frame()
    assert links["detections"].sum() == len(fitted.residuals)
    assert links["used"].sum() == fitted.residuals.used.sum()
    own = links.filter(pl.col("distance") == 0)
    assert (own["used"] > 0.95 * own["in_fit"]).all()
    assert (own["used"] > 50).all()
    assert links.filter(pl.col("used") > 5)["median"].abs().max() < 2e-4


def test_summary_names_receivers_counts_and_notes(fitted):
    text = fitted.summary()
    for name in fitted.receivers.names:
        assert name in text
    assert f"{int(fitted.residuals.used.sum())} used" in text
    assert "common time is the clock of receiver R001 (asked for)" in text
    assert "reflected" in text


def test_repr(fitted):
    assert repr(fitted).startswith("ClockSync: 5 of 5 receivers on the clock of R001, ")


def test_same_input_same_output(fitted):
    again = sync.fit(TRUTH.detections, TRUTH.receivers, reference="R001")
    np.testing.assert_array_equal(again.values, fitted.values)
    np.testing.assert_array_equal(again.residuals.residual, fitted.residuals.residual)


def test_shapes_are_checked(fitted):
    with pytest.raises(InputError, match=r"ClockSync\.values must have shape"):
        dataclasses.replace(fitted, values=fitted.values[:, :-1])
    with pytest.raises(InputError, match="reference 'X'"):
        dataclasses.replace(fitted, reference="X")


def test_offset_of_a_raw_time_is_near_the_truth(fitted):
    relative, inside = TRUTH.relative(1)
    got = fitted.offset(TRUTH.detections.receiver, TRUTH.detections.time)
    assert np.abs((got - relative)[inside & (TRUTH.clock != 1)]).max() < 1.5e-3
    assert fitted.origin % 10**9 == 0
    assert abs(fitted.origin - ORIGIN) < 5 * 3600 * 10**9


def test_figures_show_every_clock_and_arrival(fitted):
    from matplotlib.figure import Figure

    from maloc.plots import clocks, sync_residuals

    ax = clocks(fitted, Figure().subplots())
    assert len(ax.lines) == 5
    ax = sync_residuals(fitted, Figure().subplots())
    drawn = sum(len(np.asarray(c.get_offsets())) for c in ax.collections)
    assert drawn == np.isfinite(fitted.residuals.p_direct).sum()
