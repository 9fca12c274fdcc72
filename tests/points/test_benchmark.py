"""The benchmark runs, small, and its tables say what they should."""

from __future__ import annotations

import sys

import pytest

from benchmarks import points


def test_tables(monkeypatch, capsys):
    small = {k: v for k, v in points.METHODS.items() if k in ("closed-form", "consensus")}
    monkeypatch.setattr(points, "METHODS", small)
    monkeypatch.setattr(sys, "argv", ["points", "--pings", "200", "--trials", "400"])
    points.main()
    rows = [line.split() for line in capsys.readouterr().out.splitlines() if line]
    timed, told, roots = (
        rows[i + 1 : i + 3] for i, r in enumerate(rows) if r[0] in ("method", "30", "three")
    )
    assert [r[0] for r in timed] == ["closed-form", "consensus"]
    assert float(told[0][1]) == pytest.approx(0.945, abs=0.03)  # inliers kept
    assert float(told[0][2]) > 0.97  # outliers rejected
    for row in roots:
        assert float(row[1]) == 1 and float(row[3]) == 1
    stated = rows[-1]
    assert stated[1] == "geometries" and float(stated[2]) >= 0.9
