"""The small hard inputs of ../shared/cases, as far as positions: every ping near its truth."""

import numpy as np
import polars as pl
import pytest

import maloc
from maloc.data import Detections
from maloc.errors import InputError
from maloc.points import locate
from maloc.readers import read_receivers

FISH = "A69-1602-12345"
C = 1475.0


def positions(detections: Detections, receivers, tag=FISH):
    """Each ping by itself: least squares by consensus, no model of movement to lean on."""
    toa = maloc.toa_matrix(detections, receivers, tag, sound_speed=C)
    return locate(toa).position


def truth(path):
    return pl.read_csv(path).select("x", "y").to_numpy()


@pytest.mark.parametrize(
    ("number", "file", "receivers"),
    [
        ("01", "vue.csv", "receivers.csv"),
        ("02", "vue.csv", "receivers.csv"),
        ("03", "vue_eu.csv", "receivers_eu.csv"),
    ],
)
def test_01_02_03_positions(case, number, file, receivers):
    folder = case(number)
    found = positions(
        maloc.read_detections(folder / file), maloc.read_receivers(folder / receivers)
    )
    reference = [(119.82, 90.16), (127.63, 96.85), (139.44, 103.39), (147.48, 112.37),
                 (159.95, 117.94)]  # fmt: skip
    np.testing.assert_allclose(found, reference, atol=0.3)
    error = np.hypot(*(found - truth(folder / "truth.csv")).T)
    assert error.max() < 0.8


def test_06_positions_after_synchronisation(case):
    folder = case("06")
    tags = pl.read_csv(folder / "sync_tags.csv", schema_overrides={"serial": pl.String})
    table = pl.read_csv(folder / "receivers.csv", schema_overrides={"serial": pl.String})
    table = table.join(tags.rename({"transmitter": "sync_tag"}), on="serial")
    receivers = read_receivers(table)
    raw = maloc.read_detections(folder / "vue.csv")
    sync = maloc.sync.fit(raw, receivers, sound_speed=C, reference="301001")
    toa = maloc.toa_matrix(sync.apply(raw), sync.receivers, FISH, sound_speed=C)
    found = locate(toa).position
    np.testing.assert_allclose(found, truth(folder / "truth_fish.csv"), atol=3)


@pytest.mark.parametrize("tag", ["A69-1601-12345", "A69-9001-12345"])
def test_07_each_code_space_has_its_track(case, tag):
    folder = case("07")
    found = positions(
        maloc.read_detections(folder / "vue.csv"),
        maloc.read_receivers(folder / "receivers.csv"),
        tag,
    )
    np.testing.assert_allclose(found, truth(folder / f"truth_{tag}.csv"), atol=3)


def test_09_a_moved_receiver_counts_where_it_stood(case):
    folder = case("09")
    d = maloc.read_detections(folder / "vue.csv")
    found = positions(d, maloc.read_receivers(folder / "deployments.csv"))
    both = np.vstack([truth(folder / f"truth_{i}.csv") for i in (1, 2)])
    np.testing.assert_allclose(found, both, atol=3)
    once = pl.read_csv(folder / "deployments.csv").unique("serial", maintain_order=True)
    wrong = read_receivers(once.drop("start_utc", "stop_utc"))
    toa = maloc.toa_matrix(
        d.select(mask=d.time > d.time.min() + 5 * 86400 * 10**9), wrong, FISH, sound_speed=C
    )
    plain = locate(toa, "least-squares").position
    assert np.hypot(*(plain[-5:] - both[-5:]).T).max() > 15  # what one place for it would have done


def test_11_positions(case):
    folder = case("11")
    found = positions(
        maloc.read_detections(folder / "vue.csv"), maloc.read_receivers(folder / "receivers.csv")
    )
    i = np.arange(16)
    np.testing.assert_allclose(found, np.column_stack([150 + 3 * i, 110 + 2 * i]), atol=3)


def test_12_corrected_times(case):
    folder = case("12")
    receivers = maloc.read_receivers(folder / "receivers.csv")
    logs, raw = sorted(folder.glob("VR2Tx_*")), sorted(folder.glob("uncorrected_*"))
    corrected = maloc.read_detections(*logs)
    device = maloc.read_detections(*logs, clock="device")
    assert len(corrected) == 24 and corrected.tags == (FISH,)
    moved = (corrected.time - device.time) / 1e9
    at = {r: moved[corrected.receiver == r][-1] for r in corrected.receivers}
    assert at["480102"] == pytest.approx(2.2, abs=1e-4)  # on the way to 2.4 s at the end
    assert at["480103"] == pytest.approx(-3.5, abs=1e-4)
    expected = truth(folder / "truth.csv")
    np.testing.assert_allclose(positions(corrected, receivers), expected, atol=1)

    uncorrected = maloc.read_detections(*raw)
    assert uncorrected.time.tolist() == device.time.tolist()
    said = [n.text for n in uncorrected.report.notes]
    assert sum("no clock correction was applied" in s for s in said) == 4
    assert any("480102" in s and "+1.2 s" in s and "+2.4 s" in s and "--clock linear" in s
               for s in said)  # fmt: skip
    with pytest.raises(InputError, match="unsynchronised"):
        positions(uncorrected, receivers)
    linear = maloc.read_detections(*raw, clock="linear")
    np.testing.assert_allclose(linear.time, corrected.time, atol=1e5)  # .1 ms, as printed
    np.testing.assert_allclose(positions(linear, receivers), expected, atol=1)
    with pytest.raises(InputError, match="no corrected time"):
        maloc.read_detections(*raw, clock="corrected")


def test_14_nothing_to_synchronise(case):
    folder, places = case("14"), pl.read_csv(case("01") / "receivers.csv")
    tag = pl.lit("A69-1602-6") + pl.col("serial").cast(pl.String)
    table = read_receivers(places.with_columns(tag.alias("sync_tag")))
    for name, says in (("header_only.csv", "no detections"), ("one_row.csv", "1 receiver")):
        d = maloc.read_detections(folder / name)
        with pytest.raises(InputError, match=says):
            maloc.sync.fit(d, table)
