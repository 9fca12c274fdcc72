"""The study of wrong inputs: runs once, small, and goes on where it was left."""

import json

import numpy as np
import pytest

from simulations import wrong_inputs


def test_runs_and_goes_on(tmp_path, capsys):
    out = tmp_path / "runs.jsonl"
    cases = ["clean", "limits 10 % too narrow", "receiver displaced 15 m"]
    asked = ["--runs", "1", "--pings", "60", "--out", str(out), "--cases"]
    assert wrong_inputs.main([*asked, cases[0]]) == 0
    assert wrong_inputs.main([*asked, *cases]) == 0
    said = capsys.readouterr().out.splitlines()[-4:]
    results = [json.loads(line) for line in out.read_text().splitlines()]
    assert [r["case"] for r in results] == cases
    assert [line[:38].strip() for line in said] == ["case", *cases]
    assert results[2]["suspects"] == ["receiver positions"]
    assert results[2]["receiver"]
    assert results[2]["shift_error"] < 8


def test_receivers_a_ping():
    """The scale gives as many as asked; the tracks have about as many."""
    for per_ping in (5.0, 2.5):
        rng = np.random.default_rng(0)
        heard = [wrong_inputs.track(rng, per_ping, 400).heard.sum() / 400 for _ in range(20)]
        assert np.mean(heard) == pytest.approx(per_ping, rel=0.15)


def test_summary_counts():
    row = {"index": 0, "receiver": True, "shift_error": 2.0, "cpu": [1.0, 2.0]}
    displaced = row | {"case": "receiver displaced 15 m"}
    results = [
        row | {"case": "clean", "suspects": ["sound speed"]},
        displaced | {"suspects": ["receiver positions"]},
        displaced | {"suspects": ["receiver positions"], "receiver": False, "shift_error": 9.0},
        displaced | {"suspects": ["sound speed"]},
    ]
    lines = wrong_inputs.summary(results).splitlines()
    assert lines[1].split() == ["clean", "1", "-", "-", "1", "-", "2.0"]
    assert lines[2].split()[-6:] == ["3", "2", "1", "1", "2.0", "2.0"]
