"""The study's scores and tables on draws with known answers; and that it is gone on with."""

import dataclasses
import json

import numpy as np
import polars as pl
import pytest
from scipy.stats import chi2, gaussian_kde

from maloc.errors import FitError, InputError
from maloc.simulate.hostetter_royle import Design
from maloc.studies.hostetter_royle import study
from maloc.studies.hostetter_royle.scores import count_set, in_ellipse, in_kernel, score_positions
from maloc.studies.hostetter_royle.tables import PAPER_TABLE2, pooled, ratio, report

SMALL = study.Settings(Design(side=3, tags=2, duration=20.0), draws=50, warmup=50)


def test_distances_by_hand():
    draws = np.array([[[0.0, 0.0]], [[2.0, 0.0]], [[1.0, 3.0]]])
    scores = score_positions(draws, np.array([[1.0, 0.0]]))
    assert scores.distance == pytest.approx([1.0])
    assert scores.precision == pytest.approx([5 / 3])


@pytest.mark.parametrize("held", [in_ellipse, in_kernel])
@pytest.mark.parametrize("shape", ["normal", "ring"])
def test_sets_hold_what_they_claim(held, shape):
    """Truths drawn like the draws: in 95 % of the sets, also where the posterior is a ring."""
    rng = np.random.default_rng(2)
    n = 1500
    if shape == "normal":
        root = np.array([[2.0, 0.0], [1.5, 0.3]])
        z = rng.standard_normal((401, n, 2)) @ root.T
    else:
        angle, radius = rng.uniform(0, 2 * np.pi, (401, n)), rng.normal(3, 0.3, (401, n))
        z = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    inside = held(z[1:], z[0]).mean()
    assert inside == pytest.approx(0.95, abs=4 * np.sqrt(0.95 * 0.05 / n))


def test_ellipse_is_mahalanobis():
    rng = np.random.default_rng(3)
    draws = rng.standard_normal((20_000, 1, 2)) * [1.0, 4.0]
    edge = np.sqrt(chi2.ppf(0.95, 2))
    for factor, inside in ((0.97, True), (1.03, False)):
        assert in_ellipse(draws, np.array([[0.0, 4 * factor * edge]]))[0] == inside
        assert in_ellipse(draws, np.array([[factor * edge, 0.0]]))[0] == inside


def test_kernel_set_is_scipys_with_own_kernel_left_out():
    """The middle of a ring lies outside; SciPy's density of all others gives the same verdict."""
    rng = np.random.default_rng(4)
    angle = rng.uniform(0, 2 * np.pi, 200)
    ring = 3 * np.stack([np.cos(angle), np.sin(angle)], axis=1) + rng.normal(0, 0.2, (200, 2))
    points = np.concatenate([np.zeros((1, 2)), rng.uniform(-4, 4, (30, 2))])
    mine = in_kernel(np.repeat(ring[:, None], len(points), axis=1), points)
    kernel = gaussian_kde(ring.T)
    own = 1 / (200 * 2 * np.pi * np.sqrt(np.linalg.det(kernel.covariance)))
    threshold = np.quantile((kernel(ring.T) - own) * 200 / 199, 0.05)
    assert np.array_equal(mine, kernel(points.T) >= threshold)
    assert not mine[0]


def test_count_sets_are_the_smallest():
    pmf = np.array([[0.05, 0.6, 0.3, 0.05], [1.0, 0.0, 0.0, 0.0], [0.5, 0.4, 0.1, 0.0]])
    assert count_set(pmf).tolist() == [
        [False, True, True, False],
        [True, False, False, False],
        [True, True, False, False],
    ]


def test_standard_errors_by_simulation():
    """Linearised: the spread of the ratio over repeated studies."""
    rng = np.random.default_rng(5)
    found = []
    for _ in range(400):
        count = rng.integers(20, 60, 30)
        level = rng.normal(1.0, 0.2, 30)
        found.append(ratio(level * count, count))
    values = np.array(found)
    assert values[:, 0].mean() == pytest.approx(1.0, abs=0.01)
    assert values[:, 1].mean() == pytest.approx(values[:, 0].std(), rel=0.1)
    assert np.isnan(ratio(np.array([1.0]), np.array([2.0])).se)


def made_up(n=4):
    """Results whose tables are known: known interval at distance k + 1, unknown twice that."""
    tables = []
    for i in range(n):
        for factor, model in enumerate(("known_interval", "unknown_interval"), 1):
            about = {"dataset": i, "model": model}
            for k in (0, 1, 2) if factor == 1 else (1, 2):
                for j in range(5):
                    tables.append(
                        {
                            **about,
                            "section": "position",
                            "tag": "01",
                            "time": float(10 * k + j),
                            "detections": k,
                            "distance": float(factor * (k + 1)),
                            "precision": 2.0 * factor * (k + 1),
                            "ellipse": j > 0,
                            "kernel": True,
                        }
                    )
            for name, true in (("sigma_step", 0.25), ("scale", 0.75), ("p0", 0.5)):
                row = {"name": name, "true": true, "mean": true * (1 + 0.1 * (i - 1.5))}
                row |= {"ess": 100.0, "r_hat": 1.01}
                tables.append({**about, "section": "parameter", **row})
            run = {"cpu": 60.0, "cpu_after_warmup": 10.0 * factor, "divergences": 1.0}
            run |= {"draws": 400.0, "steps": 7.0, "r_hat_position": 1.02}
            tables += [{**about, "section": "run", "name": k, "mean": v} for k, v in run.items()]
        gap = {"section": "gap", "dataset": i, "model": "unknown_interval", "tag": "01"}
        tables.append(
            {**gap, "name": "inside", "true": 10.0, "mean": 11.0, "covered": True, "sure": False}
        )
        tables.append(
            {**gap, "name": "before", "true": 10.0, "mean": 9.0, "covered": i > 0, "sure": False}
        )
    return pl.DataFrame(tables, infer_schema_length=None)


def test_tables_of_known_results():
    text = report(made_up())
    lines = text.splitlines()
    first = next(s for s in lines if s.startswith("Mvmt KI") and "sigma_u" in s).split()
    assert [float(v) for v in first[3:]] == pytest.approx(
        [0.25, 0.25, 0.0161, 0, 0.065, 0], abs=6e-4
    )
    second = next(s for s in lines if s.startswith("Mvmt UI") and s.split()[2] == "2")
    assert "6.000  0.000  (0.46)" in second and "12.000" in second
    assert second.split()[-2:] == ["0.800", "0.000"]
    zero = next(s for s in lines if s.startswith("Mvmt KI") and s.split()[2] == "0")
    assert f"({PAPER_TABLE2['known_interval'][0][0]:.2f})" in zero
    at = lines.index("Unknown over known interval, mean distances of the same pings")
    assert lines[at + 2].split() == ["1", "20", "2.000", "4.000", "2.000", "0.000"]
    assert "40 true, relative bias +0.1000 (se 0.0000), root mean square error a tag 1.00" in text
    assert "80 true, relative bias +0.0000" in text
    assert "0.875 (se 0.125) of 8 gaps" in text
    speeds = [s.split()[2] for s in lines[-4:] if s.startswith("Mvmt")]
    assert speeds == ["10.00", "5.00"]


def test_pooled_counts_positions_not_data_sets():
    table = pl.DataFrame({"dataset": [0, 0, 0, 1], "d": [1.0, 1.0, 1.0, 5.0]})
    assert pooled(table, "d").value == pytest.approx(2.0)


def test_failed_fits_are_said():
    row = {"dataset": [0], "model": ["independent"], "section": ["failed"], "name": ["no mode"]}
    assert "1 fits failed" in report(pl.DataFrame(row))
    assert "data set 0, independent: no mode" in report(pl.DataFrame(row))


def test_done_jobs_are_kept_and_others_done(tmp_path, monkeypatch):
    """What lies in the folder is read, not made again; a half-written file does not count."""
    done = pl.DataFrame({"dataset": [0], "model": ["independent"], "section": ["made"]})
    (tmp_path / "study.json").write_text(SMALL.as_text())
    done.write_parquet(tmp_path / "0000_independent.parquet")
    (tmp_path / "0001_independent.123.part").write_text("killed here")
    asked = []

    def fit_job(settings, index, model):
        asked.append((index, model))
        return done.with_columns(dataset=pl.lit(index))

    monkeypatch.setattr(study, "fit_job", fit_job)
    monkeypatch.setattr("concurrent.futures.ProcessPoolExecutor", Inline)
    found = study.run_study(SMALL, 2, tmp_path, models=["independent"], quiet=True)
    assert asked == [(1, "independent")]
    assert found["dataset"].to_list() == [0, 1]
    again = study.run_study(SMALL, 2, tmp_path, models=["independent"], quiet=True)
    assert again.equals(found) and asked == [(1, "independent")]


class Inline:
    """A pool that works at once, in this process."""

    def __init__(self, *_, **__):
        pass

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None

    def submit(self, job, *args):
        from concurrent.futures import Future

        future = Future()
        future.set_result(job(*args))
        return future


def test_a_failed_fit_leaves_a_file_that_says_so(tmp_path, monkeypatch):
    def fit_job(*_):
        raise FitError("no finite mode")

    monkeypatch.setattr(study, "fit_job", fit_job)
    assert "data set 3, independent: no finite mode" in study._job(
        SMALL, 3, "independent", tmp_path
    )
    row = pl.read_parquet(tmp_path / "0003_independent.parquet").to_dicts()[0]
    assert row["section"] == "failed" and row["name"] == "no finite mode"


def test_other_settings_and_other_folders_are_refused(tmp_path):
    other = dataclasses.replace(SMALL, draws=100)
    (tmp_path / "study.json").write_text(other.as_text())
    assert json.loads(other.as_text())["design"]["side"] == 3
    with pytest.raises(InputError, match="other settings"):
        study.run_study(SMALL, 1, tmp_path)
    strange = tmp_path / "strange"
    strange.mkdir()
    (strange / "letter.txt").write_text("Dear Sir")
    with pytest.raises(InputError, match="nor a study's folder"):
        study.run_study(SMALL, 1, strange)
    with pytest.raises(InputError, match="none of independent"):
        study.run_study(SMALL, 1, tmp_path / "new", models=["sorcery"])


def test_the_command_in_small(tmp_path, capsys):
    """Whole: processes, two models, tables, and gone on with at once."""
    from simulations import hostetter_royle

    asked = ["--datasets", "1", "--tags", "2", "--side", "3", "--duration", "20", "--draws", "50"]
    asked += ["--models", "independent,known_interval"]
    asked += ["--workers", "2", "--quiet", "--seed", "4", "--out", str(tmp_path / "study")]
    assert hostetter_royle.main(asked) == 0
    said = capsys.readouterr().out
    for label in ("Ind. loc", "Mvmt KI"):
        assert sum(s.startswith(label) for s in said.splitlines()) >= 4
    assert "relative bias" in said
    assert len(list((tmp_path / "study").glob("*.parquet"))) == 2
    assert hostetter_royle.main(asked) == 0
    assert capsys.readouterr().out == said
