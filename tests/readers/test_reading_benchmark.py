"""The benchmark of reading runs, and what it reads is what it wrote."""

import sys

import numpy as np

from benchmarks import readers
from maloc.readers import read_detections


def test_it_runs(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["readers", "--rows", "500"])
    readers.main()
    lines = capsys.readouterr().out.splitlines()
    assert [s.split()[0] for s in lines] == ["format", "vue", "vdat"]
    assert all(s.split()[2:4] == ["500", "500"] for s in lines[1:])


def test_made_up_exports_come_back(tmp_path):
    table = readers.made_up(300, seed=3)
    for name, write in readers.WRITERS.items():
        write(table, tmp_path / name)
        d = read_detections(tmp_path / name)
        np.testing.assert_array_equal(d.time, table["time"].to_physical().to_numpy() * 1_000_000)
        assert d.receiver.tolist() == [str(s) for s in table["serial"]]
        assert d.tag.tolist() == [f"A69-1602-{i}" for i in table["id"]]
