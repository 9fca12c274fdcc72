"""Echoes, impossible repeats, deployments and odd clocks, against planted ones and brute force."""

from itertools import combinations

import numpy as np
import pytest

from maloc.data import Detections, Receivers, prepare
from maloc.data._screen import _heaviest
from maloc.data.preparation import clock_notes
from maloc.readers import read_detections
from maloc.readers.check import check

NS = 1_000_000_000
T0 = 1_622_548_800 * NS


def detections(*heard):
    """Detections from (receiver, tag, seconds) triples."""
    receiver, tag, seconds = zip(*heard, strict=True)
    time = T0 + np.rint(np.array(seconds) * NS).astype(np.int64)
    return Detections(time, np.array(receiver, str), np.array(tag, str))


@pytest.mark.parametrize("seed", range(20))
def test_the_most_is_kept_of_what_is_too_near(seed):
    rng = np.random.default_rng(seed)
    time = np.sort(rng.uniform(0, 100, 9))
    worth, apart = 1 + 0.01 * rng.integers(0, 5, 9), 12.0

    def allowed(rows):
        return all(b - a >= apart for a, b in zip(time[rows][:-1], time[rows][1:], strict=True))

    subsets = (list(c) for n in range(1, 10) for c in combinations(range(9), n))
    best = max(worth[rows].sum() for rows in subsets if allowed(rows))
    found = _heaviest(time, worth, apart)
    assert allowed(found) and worth[found].sum() == pytest.approx(best)


def simulated(n=60, receivers=3, seed=1):
    """One tag at some receivers, their clocks hours apart; and false detections at one of them."""
    rng = np.random.default_rng(seed)
    sent = np.cumsum(rng.uniform(20, 40, n))
    heard = [(f"R{r}", "A-1", t + 3000.0 * r) for r in range(receivers) for t in sent]
    false = [("R0", "A-1", sent[i] + dt) for i, dt in ((10, 7.0), (30, -6.0), (45, 9.5))]
    return heard, false


def test_false_detections_at_one_receiver_are_found():
    heard, false = simulated()
    d = detections(*heard, *false)
    found = prepare(d, limits={"A-1": (20.0, 40.0)})
    assert np.flatnonzero(found.too_soon).tolist() == [len(heard), len(heard) + 1, len(heard) + 2]
    assert len(found.kept) == len(heard)
    assert "3 detections too soon" in str(found.kept.report)
    assert found.why[-1].startswith("9.500 s from another at R0")
    assert not prepare(d).too_soon.any()  # nothing is known of the interval


def test_what_several_receivers_heard_too_soon_was_sent():
    heard, _ = simulated()
    burst = [(f"R{r}", "A-1", 3000.0 * r - 60 + 5.38 * k) for r in range(3) for k in range(4)]
    found = prepare(detections(*burst, *heard), limits={"A-1": (20.0, 40.0)})
    assert not found.too_soon.any()
    (said,) = [n for n in found.notes if n.level == "warning"]
    assert "several receivers heard them" in said.text and said.count == 9


def test_whole_seconds_may_seem_sooner_by_one():
    for gap, gone in ((19, 0), (18, 49)):  # 20 s, cut to whole seconds and reflected
        sent = np.cumsum(np.tile([gap, 40.0 - gap], 50))
        found = prepare(detections(*(("A", "x", t) for t in sent)), limits={"x": (20.0, 40.0)})
        assert int(found.too_soon.sum()) == gone


def test_echoes_are_marked_with_what_they_repeat():
    d = detections(
        ("A", "x", 0.0), ("A", "x", 0.043), ("A", "x", 0.3), ("A", "x", 0.6), ("B", "x", 0.05),
        ("A", "y", 0.1), ("A", "x", 30.0),
    )  # fmt: skip
    found = prepare(d)
    assert found.echo_of.tolist() == [-1, 0, 0, -1, -1, -1, -1]
    assert found.why[1] == "echo, 43 ms after the first" and found.why[3] == ""
    fast = prepare(d, limits={"x": (0.5, 1.0)})  # a tag that pings every .5 to 1 s
    assert fast.echo_of.tolist() == [-1, 0, -1, -1, -1, -1, -1]


def test_lone_detections_are_pointed_out_and_kept():
    d = detections(*(("A", "x", 30.0 * k) for k in range(5)), ("B", "x", 5000.0))
    found = prepare(d, limits={"x": (20.0, 40.0)})
    assert found.lone.tolist() == [False] * 5 + [True] and (found.why == "").all()
    assert any("perhaps false" in n.text for n in found.notes)


def test_deployments():
    r = Receivers(
        np.array(["A", "B"]), np.zeros(2), np.arange(2.0), start=np.array([T0, T0]),
        end=np.array([T0 + 10 * NS, T0 + 100 * NS]),
    )  # fmt: skip
    found = prepare(detections(("A", "x", 5.0), ("A", "x", 50.0), ("C", "x", 5.0)), r)
    assert found.why.tolist() == [
        "",
        "outside any deployment of A",
        "receiver C is not in the table",
    ]
    assert [n.count for n in found.notes] == [1, 1]


def test_clocks_that_cannot_be_right():
    rows = [("A", "x", 30.0 * k) for k in range(50)] + [("B", "x", 30.0 * k) for k in range(50)]
    assert clock_notes(detections(*rows)) == []
    back = [("A", "x", 30.0 * k - 7200 * (k > 30)) for k in range(50)]
    (said,) = clock_notes(detections(*back, *rows[50:]))
    assert "times of A go back 1 time (first by 120 min" in said.text
    away = [("C", "x", 30.0 * k + 90 * 86400) for k in range(9)]
    (said,) = clock_notes(detections(*rows, *away))
    assert said.text.startswith("C heard tags only from")
    unset = Detections(np.array([5 * NS, T0]), np.array(["A", "A"]), np.array(["x", "x"]))
    assert "dated before 2000" in clock_notes(unset)[0].text


def test_check_screens_by_the_table_of_tags(tmp_path):
    heard, false = simulated()
    lines = [
        f"{np.datetime64(T0 + round(t * NS), 'ns')},{r},A69-1602-1" for r, _, t in heard + false
    ]
    (tmp_path / "d.csv").write_text("time,receiver,tag\n" + "\n".join(lines) + "\n")
    (tmp_path / "tags.csv").write_text("tag,animal,min_delay,max_delay\nA69-1602-1,eel,20,40\n")
    text = str(check([tmp_path / "d.csv", tmp_path / "tags.csv"]))
    assert "3 detections too soon" in text and "tags table" in text
    assert "too soon" not in str(check([tmp_path / "d.csv"]))


def test_raw_export_of_a_tag_that_pings_faster_when_switched_on(shared_dir):
    d = read_detections(shared_dir / "data" / "ssu1" / "VUE_Export_ssu1.csv")
    found = prepare(d, limits={"A69-1602-15266": (20.0, 40.0)})
    assert not found.too_soon.any()
    assert any("when switched on?" in n.text for n in found.notes)
