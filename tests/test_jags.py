"""The benchmark against JAGS: its data format, its output, and a word where JAGS is absent."""

import shutil
import sys

import numpy as np
import pytest

from benchmarks import jags
from maloc.simulate.hostetter_royle import Design, simulate_study


@pytest.fixture(scope="module")
def history():
    design = Design(tags=2, side=3, duration=12.0, buffer=0.0)
    return simulate_study(np.random.default_rng(1), design).history("known_interval")


def test_arrays_go_by_column():
    assert jags._dump("a", np.array([[1, 2], [3, 4]])) == (
        "a <- structure(c(1, 3, 2, 4), .Dim = c(2, 2))\n"
    )
    assert jags._dump("n", np.asarray(3)) == "n <- 3\n"


def test_data_say_where_tags_begin(history):
    text = dict(line.split(" <- ") for line in jags.jags_data(history).splitlines())
    n = int((history.tag == 0).sum())
    assert text["first"] == f"c(1, {n + 1})"
    assert text["last"] == f"c({n}, {len(history)})"
    assert text["y"].endswith(f".Dim = c(9, {len(history)}))")


def test_draws_are_read_by_name(tmp_path):
    (tmp_path / "CODAindex.txt").write_text("p0 1 2\nsigma.u 3 4\n")
    (tmp_path / "CODAchain1.txt").write_text("1 .5\n2 .6\n1 .2\n2 .3\n")
    found = jags.read_coda(tmp_path)
    assert list(found["p0"]) == [0.5, 0.6] and list(found["sigma.u"]) == [0.2, 0.3]


def test_jags_runs_panel_1(history):
    if shutil.which("jags") is None:
        pytest.skip(jags.MISSING)
    speed = jags.jags(history, adapt=50, burn=0, keep=200)
    assert 0.2 < speed.mean["p0"] < 1 and speed.cpu > 0
    assert set(speed.ess) == {"p0", "scale", "sigma_step"}


@pytest.mark.extended
def test_without_jags_it_says_so(monkeypatch, capsys):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    asked = ["--tags", "2", "--side", "3", "--duration", "20", "--draws", "50"]
    monkeypatch.setattr(sys, "argv", ["jags", *asked])
    jags.main()
    said = capsys.readouterr().out
    assert jags.MISSING in said
    assert sum(s.startswith("maloc ") for s in said.splitlines()) == 2
