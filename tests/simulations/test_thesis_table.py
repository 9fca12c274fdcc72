"""The classical chain as methods of the canal study, and the command that prints its table."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest
from scipy.stats import binom

from maloc.biology.space import inside
from maloc.simulate.arrays import canal
from maloc.simulate.canal import CanalDesign
from maloc.studies.canal import study
from maloc.studies.canal.cases import own_cases
from maloc.studies.canal.methods import METHODS, Located
from maloc.studies.canal.thesis import STEPS_C1, TABLE_C1
from simulations import thesis_table

SETTINGS = study.Settings(CanalDesign(n_pings=60, in_water=True))


@pytest.fixture(scope="module")
def case():
    return study.case_of(SETTINGS, own_cases(1, (0.2,), (0.06,))[0])


def error(found, case):
    return np.linalg.norm(found.position - case.truth, axis=1)


def test_fish_keep_to_the_water(case):
    assert inside(case.truth, canal().water).all()
    roaming = study.Settings(CanalDesign(n_pings=60))
    free = study.case_of(roaming, own_cases(1, (0.2,), (0.06,))[0])
    assert not inside(free.truth, canal().water).all()


def test_filters_take_from_least_squares_and_change_nothing_else(case):
    whole = METHODS["ls"](case, SETTINGS)
    kept = np.isfinite(error(whole, case))
    for step in ("speed", "two", "three"):
        found = METHODS[f"ls-{step}"](case, SETTINGS)
        mine = np.isfinite(error(found, case))
        assert (kept | ~mine).all() and 20 < mine.sum() < kept.sum()
        np.testing.assert_array_equal(found.position[mine], whole.position[mine])
        assert np.median(error(found, case)[mine]) <= np.median(error(whole, case)[kept])
        kept = mine if step != "speed" else kept  # stages take more and more; the first by itself
    assert error(found, case)[mine].mean() < 0.6 * np.nanmean(error(whole, case))


@pytest.mark.parametrize("movement", ["", "-rw", "-crw"])
def test_the_smoother_beats_the_filter_where_nothing_is_late(movement):
    clean = study.case_of(SETTINGS, own_cases(1, (0.5,), (0.0,))[0])
    kept = np.isfinite(METHODS["ls-three"](clean, SETTINGS).position).all(axis=1)
    forth, back = (METHODS[f"ls-{step}{movement}"](clean, SETTINGS) for step in ("kf", "rts"))
    for found in (forth, back):
        np.testing.assert_array_equal(np.isfinite(error(found, clean)), kept)
    assert error(back, clean)[kept].mean() < error(forth, clean)[kept].mean() < 3
    assert (back.sd[kept] <= forth.sd[kept] + 1e-9).all()


def test_ek_toa_has_every_heard_ping(case):
    clean = study.case_of(SETTINGS, own_cases(1, (0.2,), (0.0,))[0])
    found = METHODS["ek-toa"](clean, SETTINGS)
    off = error(found, clean)
    np.testing.assert_array_equal(np.isfinite(off), clean.toa.n_heard > 0)
    assert np.nanmean(off) < 1.5 < np.nanmean(error(METHODS["ek-toa"](case, SETTINGS), case))


def test_steps_of_table_c1():
    assert STEPS_C1.keys() == TABLE_C1.keys()
    assert STEPS_C1[0.0, 0.0] == (0.62, 3.41) and STEPS_C1[0.5, 0.15] == (72.49, 44.03)
    assert all(TABLE_C1[c].chain < step.kf for c, step in STEPS_C1.items())


@pytest.mark.parametrize("missing", [0.1, 0.2, 0.3, 0.4, 0.5])
def test_least_squares_of_the_thesis_loses_pings_of_three_of_six_receivers(missing):
    """What docs/classical.md says of it: .62 m, and 112 m where at most three of six hear."""
    lost = binom(6, 1 - missing).cdf(3)
    assert 0.62 + 112 * lost == pytest.approx(TABLE_C1[missing, 0.0].ls, rel=0.12)


def test_the_command_in_small(tmp_path, capsys, monkeypatch):
    """In this process, the tracks replaced by one that is half a metre off."""

    def half(case, settings):
        sd = np.full(case.truth.shape, 0.5)
        position = case.truth + [0.3, 0.4]
        return Located(position, sd, position - 1, position + 1)

    def inline(settings, cases, methods, out, **_):
        jobs = [study.fit_job(settings, c, m) for c in cases for m in methods]
        return pl.concat(jobs, how="diagonal_relaxed")

    monkeypatch.setitem(METHODS, "toa", half)
    monkeypatch.setitem(METHODS, "yaps", half)
    asked = ["--tracks", "1", "--pings", "60", "--missing", "0", "--late", "0,0.06", "--quiet"]
    (tmp_path / "note").write_text("")
    assert thesis_table.main([*asked, "--out", str(tmp_path)]) == 2
    assert "neither empty" in capsys.readouterr().err
    monkeypatch.setattr(thesis_table, "run_canal", inline)
    assert thesis_table.main(asked) == 0
    lines = capsys.readouterr().out.splitlines()
    head = lines[1].split()
    clean, late = (dict(zip(head[3:], s.split()[3:], strict=True)) for s in lines[2:4])
    assert [clean[n] for n in ("YAPS", "LS", "outl.", "KF", "RTSS")] == [
        "0.58", "0.62", "0.62", "3.41", "2.09"
    ]  # fmt: skip
    assert clean["toa"] == "0.50" and float(clean["ls"]) < 1.0 < float(clean["rts-wide"])
    assert float(late["ls"]) > 5 and float(late["three"]) < float(late["ls"])
    share = dict(zip(head[3:15], lines[7].split()[3:], strict=False))
    assert share["toa"] == "1.000" and float(share["three"]) < float(share["ls"]) <= 1
    ratio = next(s for s in reversed(lines) if s.lstrip().startswith("0.00 / 0.00")).split()
    want = pytest.approx(float(clean["ls"]) / 0.5, abs=0.011)
    assert ratio[3] == "toa" and float(ratio[4]) == want and float(ratio[6]) == want
    assert ratio[8] == "1.07)" and ratio[-1] == "outl.)"


@pytest.mark.extended
def test_yaps_model_beside_the_track(case):
    off = {m: np.nanmean(error(METHODS[m](case, SETTINGS), case)) for m in ("toa", "yaps")}
    assert off["toa"] < 1.0 and off["yaps"] < 1.5
