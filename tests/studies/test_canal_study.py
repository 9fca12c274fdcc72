"""The canal study: simulator, oracle, scores and tables by hand; the command once, tiny."""

import dataclasses

import numpy as np
import polars as pl
import pytest
from scipy.stats import multivariate_normal

from maloc.data.arrivals import ArrivalTimes, Schedule
from maloc.data.receivers import Receivers
from maloc.errors import FitError, InputError
from maloc.evaluate.scores import centre_of, ping_scores, track_scores
from maloc.simulate.animals import ctcrw
from maloc.simulate.canal import CanalDesign, canal_receivers, simulate_canal
from maloc.studies.canal import study
from maloc.studies.canal.cases import (
    Address,
    Case,
    folder_cases,
    own_cases,
    read_case,
    read_schedules,
)
from maloc.studies.canal.known import ctcrw_of_path, path_log_density, true_values
from maloc.studies.canal.methods import METHODS, Located
from maloc.studies.canal.tables import deciles, read_peer, report
from maloc.studies.canal.thesis import TABLE_C1

SMALL = study.Settings(CanalDesign(n_pings=30), draws=50)


def simulated(p_na=0.0, p_mp=0.0, seed=0, **design):
    return simulate_canal(np.random.default_rng(seed), p_na, p_mp, design=CanalDesign(**design))


def lateness(toa, truth):
    """Arrival less emission and travel, s, (P, R)."""
    xy = np.column_stack([truth.x, truth.y])
    distance = np.linalg.norm(xy[:, None] - toa.receivers.xy, axis=2)
    return toa.toa - truth.time[:, None] - distance / toa.sound_speed[:, None]


def test_cells_differ_by_what_is_missing_and_late_alone():
    best, truth = simulated(0.0, 0.0)
    some, same = simulated(0.3, 0.06)
    worst, _ = simulated(0.5, 0.15)
    assert np.array_equal(truth.x, same.x) and np.array_equal(truth.time, same.time)
    assert best.heard.all()
    assert (worst.heard <= some.heard).all()
    assert some.heard.mean() == pytest.approx(0.7, abs=4 * np.sqrt(0.21 / 3000))
    assert worst.heard.mean() == pytest.approx(0.5, abs=4 * np.sqrt(0.25 / 3000))
    late_some, late_worst = (lateness(t, truth) > 0.02 for t in (some, worst))
    assert (late_some[worst.heard] <= late_worst[worst.heard]).all()
    assert late_worst[worst.heard].mean() == pytest.approx(0.15, abs=0.04)
    on_time = worst.heard & ~late_worst
    assert np.array_equal(worst.toa[on_time], best.toa[on_time])


def test_noise_intervals_and_detours_are_the_designs():
    toa, truth = simulated(0.0, 0.15, n_pings=400)
    error = lateness(toa, truth)
    direct = error[error < 0.02]
    assert np.sqrt(np.mean(direct**2)) == pytest.approx(1e-3 * np.sqrt(1 / 12 + 0.09), rel=0.05)
    detour = (error * toa.sound_speed[:, None])[error > 0.02]
    assert 48 < detour.min() < 60 and 290 < detour.max() < 302
    step = np.diff(truth.time)
    assert step.min() >= 20.6 and step.max() <= 36.6
    shown = toa.toa * 1e3
    assert np.abs(shown - np.rint(shown)).max() < 1e-4
    rough, truth = simulated(n_pings=400, noise="poisson")
    spread = np.mean(lateness(rough, truth) ** 2)  # E of a squared Poisson(1) is 2
    assert spread == pytest.approx(1e-6 * (2 + 1 / 12), rel=0.08)


def test_detection_falls_with_distance_and_drifts():
    toa, truth = simulated(0.2, n_pings=3000, p0=0.9, scale=40.0)
    distance = np.linalg.norm(
        np.column_stack([truth.x, truth.y])[:, None] - toa.receivers.xy, axis=2
    )
    for low, high in ((0, 20), (40, 50), (80, 100)):
        bin_ = (distance >= low) & (distance < high)
        expected = 0.8 * 0.9 * np.exp(-0.5 * (distance[bin_] / 40) ** 2)
        sd = np.sqrt(np.sum(expected * (1 - expected))) / bin_.sum()
        assert toa.heard[bin_].mean() == pytest.approx(expected.mean(), abs=4 * sd)
    from maloc.simulate.canal import _drift

    time = np.linspace(0, 1000 * 3600, 4001)
    design = CanalDesign(scale=40.0, drift_sd=0.35)
    log = _drift(np.random.default_rng(1), time, design)
    assert log.std() == pytest.approx(0.35, rel=0.1)
    kept = np.corrcoef(log[:-1], log[1:])[0, 1]
    assert kept == pytest.approx(np.exp(-250 * 3.6 / 3600), abs=0.05)


def test_a_table_of_receivers_is_used():
    xy = np.array([[0.0, 0.0], [100.0, 0.0], [0.0, 100.0]])
    receivers = Receivers(np.array(["A", "B", "C"]), xy[:, 0], xy[:, 1])
    toa, truth = simulate_canal(np.random.default_rng(0), 0.0, 0.0, receivers)
    assert toa.toa.shape == (250, 3) and len(truth.x) == 250
    assert truth.x.min() >= -60 and truth.x.max() <= 160


@pytest.mark.parametrize(
    "wrong",
    [
        {"n_pings": 1},
        {"p0": 0.0},
        {"scale": 0.0},
        {"drift_sd": -1.0},
        {"noise": "pink"},
        {"sd": -1.0},
        {"lo": 40.0},
    ],
)
def test_designs_that_cannot_be(wrong):
    with pytest.raises(InputError):
        CanalDesign(**wrong)


def test_density_of_a_path_is_the_dense_normals():
    """The filter against the joint normal of all positions, by integrating the velocity's law."""
    sigma_vel, t05 = 0.3, 200.0
    beta = -np.log(0.05) / t05
    time = np.cumsum([0.0, 20.0, 35.0, 21.0, 90.0])
    path = np.array([[0.0, 0.0], [3.0, -2.0], [9.0, 1.0], [12.0, 2.0], [10.0, 20.0]])
    fine = np.linspace(0, time[-1], 1661)  # 0.1 s
    middle = 0.5 * (fine[1:] + fine[:-1])
    upto = (middle[None] < time[1:, None]).astype(float) * (fine[1] - fine[0])
    law = sigma_vel**2 * np.exp(-beta * np.abs(middle[:, None] - middle))
    moved = upto @ law @ upto.T  # covariance of the displacements since the first position
    off = path[1:] - path[0]
    expected = sum(multivariate_normal(np.zeros(4), moved).logpdf(off[:, a]) for a in range(2))
    found = path_log_density(np.diff(time), np.diff(path, axis=0), sigma_vel, t05)
    assert found == pytest.approx(expected, abs=1e-3)


def test_true_values_are_those_of_the_simulation():
    time = np.cumsum(np.random.default_rng(1).uniform(20.6, 36.6, 1500))
    path = ctcrw(np.random.default_rng(2), time, sigma_vel=0.2, t05=300.0)
    sigma_vel, t05 = ctcrw_of_path(time, path)
    assert sigma_vel == pytest.approx(0.2, rel=0.08) and t05 == pytest.approx(300.0, rel=0.15)
    toa, truth = simulated(0.3, 0.1, n_pings=300)
    values = true_values(toa, np.column_stack([truth.x, truth.y]), truth.time)
    assert values["w"] == pytest.approx(0.1, abs=0.03)
    sigma = 1.45 * np.sqrt(1 / 12 + 0.09)
    assert values["sigma"] == pytest.approx(sigma, rel=0.1)
    clean, truth = simulated(n_pings=10)
    values = true_values(clean, np.column_stack([truth.x, truth.y]), truth.time)
    assert values["w"] == pytest.approx(0.5 / 120)
    with pytest.raises(FitError, match="emission times"):
        true_values(clean, np.column_stack([truth.x, truth.y]), np.full(10, np.nan))


def test_scores_of_pings_by_hand():
    truth = np.array([[10.0, 0.0], [0.0, 30.0], [5.0, 5.0]])
    position = np.array([[10.0, 10.0], [0.0, 26.0], [np.nan, np.nan]])
    sd = np.array([[3.0, 4.0], [1.0, 1.0], [np.nan, np.nan]])
    scores = ping_scores(truth, position, sd, position - 8, position + 8, np.zeros(2))
    assert scores["error"][:2] == pytest.approx([10.0, 4.0])
    assert scores["expected"][:2] == pytest.approx([5.0, np.sqrt(2)])
    assert scores["covered"][:2] == pytest.approx([0.5, 1.0])
    assert scores["away"] == pytest.approx([10.0, 30.0, np.hypot(5, 5)])
    assert scores["range"][:2] == pytest.approx([np.hypot(10, 10) - 10, 4.0])
    assert scores["bearing"][:2] == pytest.approx([45.0, 0.0])
    assert all(np.isnan(scores[n][2]) for n in ("error", "covered", "range", "bearing"))
    behind = -position[:1] * [1, 0]
    opposite = ping_scores(truth[:1], behind, sd[:1], behind, behind, np.zeros(2))
    assert opposite["bearing"] == pytest.approx([180.0])


def test_scores_of_tracks():
    truth = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0]])
    zigzag = truth + np.array([[0.0, 0.0], [0.0, 1.0], [0.0, 0.0], [0.0, 1.0]])
    scores = track_scores(truth, zigzag, np.array([1.0, 2.0, 3.0, 40.0]), np.arange(4.0))
    assert scores["length"] == pytest.approx(np.sqrt(2))
    assert scores["rho"] == pytest.approx(1.0)
    assert scores["r2"] == pytest.approx(np.corrcoef(np.arange(4), [1, 2, 3, 40])[0, 1] ** 2)
    assert np.isnan(track_scores(truth[:1], truth[:1], np.ones(1), np.ones(1))["length"])


def test_the_centre_is_the_theses(shared_dir):
    table = pl.read_csv(shared_dir / "data" / "sim_canal" / "receivers.csv")
    central = table.filter(pl.col("Station Name") == "S8")
    assert np.array_equal(centre_of(table["X", "Y"].to_numpy()), central["X", "Y"].to_numpy()[0])


def test_deciles_of_calibrated_errors_are_one():
    rng = np.random.default_rng(0)
    sd = rng.uniform(0.5, 4.0, 50_000)
    error = np.hypot(*(rng.standard_normal((2, 50_000)) * sd / np.sqrt(2)))
    assert deciles(sd, error) == pytest.approx(np.ones(10), abs=0.04)
    assert deciles(sd, 2 * error) == pytest.approx(2 * np.ones(10), abs=0.08)


def test_table_c1_is_whole():
    assert len(TABLE_C1) == 36
    assert TABLE_C1[0.0, 0.0] == (0.58, 0.62, 2.09)
    assert TABLE_C1[0.5, 0.15] == (2.21, 87.50, 34.46)
    assert TABLE_C1[0.3, 0.06] == (0.97, 34.43, 13.09)
    ls = [row.ls for row in TABLE_C1.values()]
    assert all(b > a for a, b in zip(ls[::6], ls[6::6], strict=False))


def given_folder(path, schedule=""):
    receivers = "receiver,x,y\nA,0,0\nB,100,0\nC,0,100\n"
    (path / "receivers.csv").write_text(receivers)
    (path / "receivers_09.csv").write_text(receivers.replace("100", "50"))
    rows = "top,x,y,ss,toa_A,toa_B,toa_C\n1.0,3,4,1450,1.1,1.2,\n30.0,5,6,1450,30.1,30.2,30.3\n"
    for name in ("track02_na30_mp06", "lake09_other"):
        (path / f"{name}.csv").write_text(rows)
    (path / "yaps_results.csv").write_text("file,mean\ntrack02_na30_mp06.csv,2.0\n")
    return path


def test_a_folders_files_and_their_arrays(tmp_path):
    given_folder(tmp_path)
    lake, track = folder_cases(tmp_path)
    assert track == Address("track02_na30_mp06", 2, 0.3, 0.06)
    assert lake[1:] == (9, -1.0, -1.0)
    case = read_case(track, tmp_path, None, Schedule("random", 20, 40))
    assert case.truth.tolist() == [[3, 4], [5, 6]] and case.emission.tolist() == [1.0, 30.0]
    assert case.toa.n_heard.tolist() == [2, 3] and case.toa.schedule.kind == "random"
    assert case.toa.receivers.xy.max() == 100
    assert read_case(lake, tmp_path, None, Schedule()).toa.receivers.xy.max() == 50
    table = tmp_path / "receivers.csv"
    assert read_case(lake, tmp_path, table, Schedule()).toa.receivers.xy.max() == 100
    assert read_peer(tmp_path / "yaps_results.csv") == {"track02_na30_mp06": 2.0}
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(InputError, match="no CSV with columns"):
        folder_cases(empty)
    with pytest.raises(InputError, match="no columns file, mean"):
        read_peer(tmp_path / "receivers.csv")
    with pytest.raises(InputError, match="does not exist"):
        read_peer(tmp_path / "nowhere.csv")


def test_schedules_by_file(tmp_path):
    table = tmp_path / "schedules.csv"
    table.write_text("file,kind,lo,hi\nlake09_other.csv,stable,60,0.001\na,random,20,40\n")
    own = read_schedules(table)
    assert own == (
        ("lake09_other", Schedule("stable", 60, 0.001)),
        ("a", Schedule("random", 20, 40)),
    )
    given_folder(tmp_path)
    settings = dataclasses.replace(SMALL, folder=tmp_path, schedules=own)
    kinds = {c.name: study.case_of(settings, c).toa.schedule.kind for c in folder_cases(tmp_path)}
    assert kinds == {"lake09_other": "stable", "track02_na30_mp06": "unknown"}
    table.write_text("file,lo,hi\n")
    with pytest.raises(InputError, match="no column kind"):
        read_schedules(table)


def test_every_cell_of_every_track():
    cases = own_cases(2, (0.0, 0.5), (0.0, 0.15))
    assert [c.name for c in cases[:2]] == ["track000_na00_mp00", "track000_na00_mp15"]
    assert len({c.name for c in cases}) == 8
    with pytest.raises(InputError, match="no share"):
        own_cases(1, (1.0,), (0.0,))


def test_jobs_score_what_a_method_says(monkeypatch):
    """A method that is off by (3, 4) m and knows it; one ping not located."""

    def off(case, settings):
        position = case.truth + [3.0, 4.0]
        position[0] = np.nan
        sd = np.full(position.shape, 2.0)
        return Located(position, sd, position - 3.5, position + 3.5, ("a warning",), 1.5)

    monkeypatch.setitem(METHODS, "off", off)
    found = study.fit_job(SMALL, own_cases(1, (0.5,), (0.15,))[0], "off")
    places = found.filter(section="position")
    assert len(places) == 30 and places["error"].is_nan().sum() == 1
    assert places["error"][1:].to_numpy() == pytest.approx(5.0)
    assert places["covered"][1:].to_numpy() == pytest.approx(0.5)  # x within 3.5 m, y not
    runs = dict(found.filter(section="run").select("name", "value").iter_rows())
    assert runs["cpu"] == 1.5 and runs["length"] == pytest.approx(1.0) and np.isnan(runs["rho"])
    assert found.filter(section="warning")["name"].to_list() == ["a warning"]
    text = report(found)
    row = next(s for s in text.splitlines() if s.startswith("off")).split()
    assert row[1:4] == ["0.50", "/", "0.15"] and row[4:6] == ["1", "0"]
    assert float(row[6]) == pytest.approx(29 / 30, abs=1e-3) and float(row[7]) == 5.0
    assert row[-3:] == ["2.21", "87.50", "34.46"]


def test_a_failed_fit_is_counted_and_said(tmp_path, monkeypatch):
    def fails(case, settings):
        raise FitError("no finite mode")

    monkeypatch.setitem(METHODS, "fails", fails)
    case = own_cases(1, (0.0,), (0.0,))[0]
    said = study._job(SMALL, case, "fails", tmp_path)
    assert said == "track000_na00_mp00, fails: no finite mode"
    found = pl.read_parquet(tmp_path / "track000_na00_mp00_fails.parquet")
    assert "failed: track000_na00_mp00, fails: no finite mode" in report(found)


def made_up():
    """Two methods, two cells, two tracks of ten pings: the second is off twice as far."""
    tables = []
    for track in range(2):
        for p_na, far in ((0.0, 1.0), (0.5, 3.0)):
            for factor, method in enumerate(("one", "two"), 1):
                about = {"case": f"t{track}_{p_na}", "track": track, "p_na": p_na, "p_mp": 0.0}
                about["method"] = method
                for ping in range(11):
                    row = {"section": "position", "ping": ping, "n_heard": 0 if ping == 10 else 3}
                    error = far * factor * (10 if ping == 10 else 1)
                    row |= {"error": error, "expected": error / 1.1, "covered": 1.0, "range": 0.5}
                    tables.append(about | row | {"bearing": 2.0, "away": 100.0 + 100 * (ping == 0)})
                run = {"cpu": 0.25, "length": 1.2, "r2": 0.1, "rho": 0.4}
                tables += [
                    about | {"section": "run", "name": k, "value": v} for k, v in run.items()
                ]
    return pl.DataFrame(tables, infer_schema_length=None)


def test_tables_of_known_results():
    lines = report(made_up(), {"t0_0.5": 4.0, "t1_0.5": 8.0}, own=False).splitlines()
    row = next(s for s in lines if s.startswith("one") and "0.50 / 0.00" in s).split()
    assert row[4:8] == ["2", "0", "1.000", "3.000"] and row[-2:] == ["6.000", "0.500"]
    assert "one: mean error from 0.00 / 0.00 to 0.50 / 0.00: x 3.00" in lines
    at = lines.index("Mean error of two over that of one, at pings with both")
    assert [s.split()[-4] for s in lines[at + 2 : at + 5]] == ["2.000"] * 3
    at = lines.index("Pings that nobody heard")
    silent = lines[at + 2].split()
    assert silent[4:6] == ["2", "10.000"]
    last = next(s for s in reversed(lines) if s.startswith("two")).split()
    assert [float(v) for v in last[1:]] == pytest.approx([1.1] * 10)
    tracks = [s for s in lines if s.startswith("one") and s.split()[-4:-3] == ["0.400"]]
    assert len(tracks) == 3 and all(s.split()[-7:-4] == ["2.000", "1.200", "0.100"] for s in tracks)


def test_points_of_a_given_array():
    """Point methods through the table of methods: good where nothing is late or missing."""
    case = study.case_of(SMALL, own_cases(1, (0.0,), (0.0,))[0])
    for method in ("consensus", "de"):
        found = METHODS[method](case, SMALL)
        error = np.linalg.norm(found.position - case.truth, axis=1)
        assert np.median(error) < 3 and (found.high >= found.low)[np.isfinite(error)].all()


def test_unheard_pings_come_by_the_bridge():
    """A track without noise: where nobody heard it the fish is between its neighbours."""
    toa, truth = simulated(0.1, n_pings=30, seed=5)
    silent = toa.toa.copy()
    silent[[0, 10, 11, 29]] = np.nan
    xy = np.column_stack([truth.x, truth.y])
    toa = ArrivalTimes(silent, canal_receivers(), toa.sound_speed, schedule=toa.schedule)
    case = Case("x", toa, xy, truth.time)
    found = METHODS["toa"](case, SMALL)
    error = np.linalg.norm(found.position - xy, axis=1)
    assert np.isfinite(error).all()
    assert (found.sd[[0, 10, 11, 29]] > 1.5 * np.median(found.sd)).all()
    assert (error < 5 * np.hypot(*found.sd.T)).all()


def ask(*options):
    from simulations import canal

    return canal.main([*options, "--quiet"])


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--drift", "0.3"], "give --detection"),
        (["--interval", "20", "40"], "give --folder"),
        (["--missing", "some"], "no list of shares"),
        (["--methods", "sorcery"], "is none of toa"),
        (["--noise", "loud"], "neither ms nor poisson"),
        (["--folder", "nowhere"], "nowhere"),
        (["--receivers", "nowhere.csv"], "nowhere.csv"),
    ],
)
def test_what_cannot_be_asked(options, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert ask(*options) == 2
    error = capsys.readouterr().err
    assert said in error and len(error.splitlines()) == 1
    assert not (tmp_path / "canal").exists()


def test_the_command_in_small(tmp_path, capsys):
    """Whole: processes, two methods, tables, and gone on with at once."""
    asked = ["--tracks", "1", "--pings", "30", "--missing", "0.3", "--late", "0.06"]
    asked += ["--detection", "1", "60", "--methods", "toa-known,consensus", "--workers", "2"]
    asked += ["--out", str(tmp_path / "study")]
    assert ask(*asked) == 0
    said = capsys.readouterr().out
    row = next(s for s in said.splitlines() if s.startswith("toa-known")).split()
    assert row[4:7] == ["1", "0", "1.000"] and "thesis" not in said
    assert "Mean error of consensus over that of toa-known" in said and "Calibration" in said
    assert len(list((tmp_path / "study").glob("*.parquet"))) == 2
    assert ask(*asked) == 0
    assert capsys.readouterr().out == said


@pytest.mark.extended
def test_silence_tells_where_nobody_heard():
    """Detection by distance: the joint model places pings that arrival times alone cannot."""
    design = CanalDesign(n_pings=40, p0=0.9, scale=30.0)
    settings = dataclasses.replace(SMALL, design=design)
    case = study.case_of(settings, own_cases(1, (0.0,), (0.06,))[0])
    found = METHODS["joint"](case, settings)
    error = np.linalg.norm(found.position - case.truth, axis=1)
    rows = np.flatnonzero(case.toa.n_heard > 0)
    inside = np.arange(rows[0], rows[-1] + 1)
    assert np.array_equal(np.flatnonzero(np.isfinite(error)), inside)
    assert (case.toa.n_heard[inside] == 0).any()
    assert np.median(error[rows]) < 8 and (error[inside] < 5 * np.hypot(*found.sd[inside].T)).all()
