"""Real and simulated files of ../shared/data: one truth in several layouts."""

import gzip

import numpy as np
import polars as pl
import pytest

from maloc.data import toa_matrix
from maloc.errors import InputError
from maloc.readers import read_detections, read_receivers, read_toa


def keys(d, tags):
    number = np.array([t.rsplit("-", 1)[-1] for t in d.tag])
    keep = np.isin(number, tags)
    return sorted(zip(d.time[keep].tolist(), d.receiver[keep], number[keep], strict=True))


def test_ssu1_export_table_and_receivers_agree(shared_dir):
    folder = shared_dir / "data" / "ssu1"
    vue = read_detections(folder / "VUE_Export_ssu1.csv")
    table = read_detections(folder / "detections.csv")
    hydros = read_receivers(folder / "hydros.csv")
    wanted = np.array(table.tags)
    mine, theirs = keys(table, wanted), keys(vue, wanted)
    assert len(mine) == len(table) == 9476
    assert set(mine) <= set(theirs)
    assert set(vue.receivers) == set(hydros.names)
    assert (hydros.depth > 0).all() and hydros.x[0] == 525973
    for short in hydros.sync_tag[hydros.sync_tag != ""]:
        assert vue.find_tag(short) == f"A69-1602-{short}"


def test_ssu1_raw_clocks_are_refused(shared_dir):
    folder = shared_dir / "data" / "ssu1"
    d = read_detections(folder / "VUE_Export_ssu1.csv")
    with pytest.raises(InputError, match="unsynchronised"):
        toa_matrix(d, read_receivers(folder / "hydros.csv"), "15266")


def test_ssu1_grouping_equals_the_synchronised_matrix(shared_dir, tmp_path):
    """YAPS's synchronised matrix, taken apart into detections, is put together again."""
    folder = shared_dir / "data" / "ssu1"
    hydros = read_receivers(folder / "hydros.csv")
    lines = (folder / "peer_yaps_toa.csv").read_text().splitlines()
    lines[0] = ",".join(hydros.names)
    (tmp_path / "toa.csv").write_text("\n".join(lines) + "\n")
    toa = read_toa(tmp_path / "toa.csv", hydros, sound_speed=1535.0)
    assert toa.origin == 1568052029 * 10**9
    cell = lines[1].split(",")[7]
    assert toa.toa[0, 7] == float(cell.split(".")[1]) / 1e6
    p, j = np.nonzero(toa.heard)
    order = np.random.default_rng(1).permutation(len(p))
    ns = np.rint(toa.toa[p, j] * 1e9).astype(np.int64) + toa.origin
    df = pl.DataFrame(
        {"time": ns[order], "receiver": np.array(hydros.names)[j[order]], "tag": ["15266"] * len(p)}
    ).with_columns(pl.col("time").cast(pl.Datetime("ns")))
    df.write_parquet(tmp_path / "d.parquet")
    again = toa_matrix(read_detections(tmp_path / "d.parquet"), hydros, "15266", sound_speed=1535.0)
    assert len(again.set_aside) == 0
    np.testing.assert_allclose(again.toa, toa.toa[toa.n_heard > 0], atol=1e-9)


def test_simulated_matrices_need_their_truth_columns_ignored(shared_dir):
    canal = shared_dir / "data" / "sim_canal"
    r = read_receivers(canal / "receivers.csv")
    assert r.names[0] == "S7" and r.xy[0].tolist() == [93.98010299017187, 14.522437458857894]
    assert any("x, y are used" in n.text for n in r.report.notes)
    assert any("without a name" in n.text for n in r.report.notes)
    for f in sorted(canal.glob("track01_*.csv")):
        toa = read_toa(f, r, ignore_columns=("top", "x", "y"))
        raw = pl.read_csv(f, null_values="NA")
        columns = [f"toa_{n}" for n in toa.receivers.names]
        expected = raw.select(pl.col(columns).cast(pl.Float64).fill_null(np.nan)).to_numpy()
        np.testing.assert_array_equal(toa.toa, expected)
        np.testing.assert_array_equal(toa.sound_speed, raw["ss"].to_numpy())
        assert not toa.report.warnings
    with pytest.raises(InputError, match="top, x, y.*ignore_columns"):
        read_toa(f, r)


def test_lake_matrices_keep_unheard_pings(shared_dir):
    lake = shared_dir / "data" / "sim_lake"
    for f in sorted(lake.glob("lake*.csv")):
        r = read_receivers(lake / f"receivers_{f.name[4:6]}.csv")
        toa = read_toa(f, r, ignore_columns=["top", "x", "y"])
        assert toa.n_pings == 400 and toa.n_receivers == 9
    assert (toa.n_heard == 0).any()


def test_gzip_and_parquet_give_the_same(shared_dir, tmp_path):
    folder = shared_dir / "data" / "ssu1"
    plain = read_detections(folder / "detections.csv")
    (tmp_path / "d.csv.gz").write_bytes(gzip.compress((folder / "detections.csv").read_bytes()))
    plain.to_frame().write_parquet(tmp_path / "d.parquet")
    for name in ("d.csv.gz", "d.parquet"):
        other = read_detections(tmp_path / name)
        assert other.time.tolist() == plain.time.tolist()
        assert other.receiver.tolist() == plain.receiver.tolist()
        assert other.tag.tolist() == plain.tag.tolist()
    hydros = read_receivers(folder / "hydros.csv")
    hydros.to_frame().write_parquet(tmp_path / "r.parquet")
    again = read_receivers(tmp_path / "r.parquet")
    np.testing.assert_array_equal(again.xy, hydros.xy)
    assert again.sync_tag.tolist() == hydros.sync_tag.tolist()
