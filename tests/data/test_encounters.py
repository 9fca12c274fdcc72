"""Encounter histories: from detections with bad clocks, and as the arrays that models take."""

# pyright: reportArgumentType=false, reportOptionalOperand=false, reportOptionalSubscript=false

import pickle

import numpy as np
import pytest

from maloc.data import (
    ArrivalTimes,
    Detections,
    EncounterHistory,
    Receivers,
    Schedule,
    covariates,
    encounter_history,
)
from maloc.errors import InputError
from maloc.model_data import prune_bound, to_model_data
from maloc.model_data.gaps import find_gaps, most_missed
from maloc.model_data.states import chain, interpolate
from maloc.schedule.renewal import gap_log_likelihood, gap_nodes, interval_law

START = 1_622_548_800 * 10**9
XY = np.array([[x, y] for x in (0.0, 300.0, 600.0) for y in (0.0, 300.0)])
NAMES = [f"R{i}" for i in range(6)]


def receivers(**changes):
    return Receivers(NAMES, XY[:, 0], XY[:, 1], **changes)


def study(rng, *, n=40, interval=(20.0, 40.0), clock=0.0, whole=False, tags=("A-1", "A-2"), p=0.3):
    """Detections of some tags, and for each its tag's index and ping; who heard what at random."""
    rows = []
    for k in range(len(tags)):
        emission = 5 + np.cumsum(rng.uniform(*interval, n))
        heard = rng.random((n, len(XY))) < p
        ping, j = np.nonzero(heard)
        rows.append((emission[ping] + rng.uniform(0, 0.4, len(ping)), j, np.full(len(j), k), ping))
    t, j, k, ping = (np.concatenate(column) for column in zip(*rows, strict=True))
    t = t + rng.uniform(-clock, clock, len(XY))[j]
    ns = START + np.round(t * 1e9).astype(np.int64)
    ns = ns // 10**9 * 10**9 if whole else ns
    mixed = rng.permutation(len(t))
    d = Detections(ns[mixed], np.array(NAMES)[j[mixed]], np.array(tags)[k[mixed]])
    return d, k[mixed], ping[mixed]


def random_history(rng, n=(12, 7), **changes):
    """A history of two tags with random times and hearers."""
    p = sum(n)
    fields = {
        "time": np.concatenate([np.cumsum(rng.uniform(1, 2, m)) for m in n]),
        "tag": np.repeat(np.arange(len(n)), n),
        "heard": rng.random((p, len(XY))) < 0.3,
        "receivers": receivers(),
        "tags": tuple(f"t{i}" for i in range(len(n))),
    }
    return EncounterHistory(**(fields | changes))


# -- from detections --------------------------------------------------------------------------


@pytest.mark.parametrize("schedule", [Schedule("random", 20, 40), Schedule()])
@pytest.mark.parametrize(("clock", "whole"), [(0.0, False), (3.5, False), (2.5, True)])
def test_pings_are_found_though_clocks_differ_by_seconds(schedule, clock, whole):
    d, tag, ping = study(np.random.default_rng(1), clock=clock, whole=whole)
    h = encounter_history(d, receivers(), schedule=schedule)
    assert h.tags == ("A-1", "A-2")
    assert len(h) == len(np.unique(np.column_stack([tag, ping]), axis=0))
    assert (h.detection >= 0).sum() == len(d) and not len(h.set_aside)
    for row in range(len(h)):
        mine = h.detection[row][h.heard[row]]
        assert len(np.unique(ping[mine])) == 1 and (tag[mine] == h.tag[row]).all()
        low, high = d.time[mine].min(), d.time[mine].max()
        assert low <= h.origin + h.time[row] * 1e9 <= high + 1


def test_the_slack_covers_what_clocks_and_rounding_do_to_intervals():
    rng = np.random.default_rng(2)
    exact, *_ = study(rng, tags=("A-1",))
    assert encounter_history(exact, receivers(), schedule=Schedule("random", 20, 40)).slack < 0.6
    rounded, *_ = study(rng, whole=True, tags=("A-1",))
    h = encounter_history(rounded, receivers(), schedule=Schedule("random", 20, 40))
    assert 1.0 <= h.slack < 2.0
    assert encounter_history(rounded, receivers(), slack=0.25).slack == 0.25


def test_a_receiver_hears_a_ping_once():
    t = START + np.array([0, 200_000_000, 3_000_000_000, 1_000_000_000, 30_000_000_000])
    d = Detections(t, ["R0", "R0", "R0", "R1", "R1"], ["A-1"] * 5)
    h = encounter_history(d, receivers(), schedule=Schedule("random", 20, 40))
    assert h.heard.sum(axis=1).tolist() == [2, 1]
    assert dict(zip(h.set_aside.detection.tolist(), h.set_aside.why.tolist(), strict=True)) == {
        1: "echo, 200 ms after the first",
        2: "second of one ping at one receiver",
    }


def test_what_cannot_count_is_set_aside_with_its_reason():
    r = receivers(start=np.full(6, START), end=np.full(6, START + 100 * 10**9))
    t = START + np.array([1, 1, 1, 200, 40, 40, 50], np.int64) * 10**9
    d = Detections(t, ["R0", "R1", "R9", "R0", "R1", "R2", "R3"], ["A-1"] * 7)
    h = encounter_history(d, r, schedule=Schedule("random", 20, 40))
    why = dict(zip(h.set_aside.detection.tolist(), h.set_aside.why.tolist(), strict=True))
    assert why.pop(2) == "receiver R9 is not in the table"
    assert why.pop(3) == "outside any deployment of R0"
    assert why.pop(6).startswith("alone, 10.000 s from a ping that 2 receivers heard")
    assert not why and len(h) == 2
    assert len(h.report.warnings) == 2


def test_known_times_make_unheard_pings_rows():
    sent = START + np.arange(0, 300, 30, dtype=np.int64) * 10**9
    d = Detections(sent[[2, 2, 5]] + 10**9 + 7, ["R0", "R3", "R3"], ["A-1"] * 3)
    stray = Detections(sent[:1] + 15 * 10**9, ["R0"], ["A-1"])
    h = encounter_history(Detections.concat([d, stray]), receivers(), pings={"1": sent}, window=5.0)
    assert h.known and len(h) == 10
    assert np.flatnonzero(h.n_heard).tolist() == [2, 5]
    assert h.heard[2].tolist() == [True, False, False, True, False, False]
    np.testing.assert_allclose(np.diff(h.time), 30)
    assert h.set_aside.why.tolist() == ["no ping was sent within 5 s"]
    assert h.detected().time.tolist() == h.time[[2, 5]].tolist() and not h.detected().known


def test_tags_never_heard_are_reported_and_sync_tags_left_out():
    d, *_ = study(np.random.default_rng(3), n=5, tags=("A-1", "A-2", "B-77"))
    r = receivers(sync_tag=["77", "", "", "", "", ""])
    assert encounter_history(d, r).tags == ("A-1", "A-2")
    h = encounter_history(d, r, ["A-2", "A-9"])
    assert h.tags == ("A-2",)
    assert [n.text for n in h.report.warnings] == ["tag A-9 was never heard: left out"]
    with pytest.raises(InputError, match="none of the 1 tags"):
        encounter_history(d, r, "A-9")


def test_clocks_too_far_apart_are_refused_with_a_mend():
    d, *_ = study(np.random.default_rng(4), clock=60.0, p=0.6)
    with pytest.raises(InputError, match="unsynchronised.*maloc.sync.rough"):
        encounter_history(d, receivers(), schedule=Schedule("random", 20, 40))
    few, *_ = study(np.random.default_rng(4), clock=60.0, p=0.25)
    h = encounter_history(few, receivers(), schedule=Schedule("random", 20, 40))
    assert "unsynchronised" in h.report.warnings[0].text


def test_windows_and_spans_that_make_no_sense():
    d, *_ = study(np.random.default_rng(5), n=5)
    with pytest.raises(InputError, match="half the shortest interval"):
        encounter_history(d, receivers(), schedule=Schedule("random", 20, 40), window=11.0)
    with pytest.raises(InputError, match="not a time"):
        encounter_history(d, receivers(), start="soon")
    with pytest.raises(InputError, match="does not say when all deployments began"):
        encounter_history(d, receivers(), start="deployed")
    with pytest.raises(InputError, match="outside the tag's start and end"):
        encounter_history(d, receivers(), start="2021-06-01T13:00:00Z")


def test_start_and_end_by_tag_by_all_and_by_deployment():
    d, *_ = study(np.random.default_rng(6), n=5)
    h = encounter_history(d, receivers(), start={"A-2": START}, end=START + 10**12)
    zero = (START - (h.origin or 0)) / 1e9
    np.testing.assert_array_equal(h.start, [np.nan, zero])
    np.testing.assert_array_equal(h.end, [zero + 1000] * 2)
    since = receivers(start=np.full(6, START - 10**9))
    again = encounter_history(d, since, start="deployed")
    np.testing.assert_array_equal(again.start, [zero - 1] * 2)


def test_arrival_times_give_the_same_hearers():
    toa = np.array([[1.0, np.nan, 1.1], [np.nan] * 3, [5.0, 5.05, np.nan]])
    r = Receivers(["a", "b", "c"], [0.0, 100.0, 50.0], [0.0, 0.0, 80.0])
    one = ArrivalTimes(toa, r, 1500.0, "x", origin=START)
    two = ArrivalTimes(toa[[0, 2]], r, 1500.0, "y", origin=START + 10**9)
    h = EncounterHistory.from_arrivals([one, two])
    assert h.known and h.tags == ("x", "y") and h.origin == START
    np.testing.assert_array_equal(h.heard, np.isfinite(np.concatenate([toa, toa[[0, 2]]])))
    np.testing.assert_allclose(h.time, [1.0, 3.0, 5.0, 2.0, 6.0])
    assert not EncounterHistory.from_arrivals(two).known


# -- the container ----------------------------------------------------------------------------


def test_histories_are_checked_once():
    rng = np.random.default_rng(7)
    h = random_history(rng)
    for changes, says in [
        ({"heard": h.heard[:, :3]}, "heard must be"),
        ({"time": h.time[::-1]}, "not in time order"),
        ({"tag": 1 - h.tag}, "grouped by tag"),
        ({"tag": 0 * h.tag}, "each with a ping"),
        ({"end": [5.0, 5.0]}, "outside the tag's start and end"),
        ({"high": h.low}, "not above its low"),
        ({"reach": 3.0}, "go together"),
    ]:
        with pytest.raises(InputError, match=says):
            h.replace(**changes)
    assert pickle.loads(pickle.dumps(h)).time.tolist() == h.time.tolist()
    with pytest.raises(ValueError, match="read-only"):
        h.heard[0, 0] = True


def test_only_heard_pings_remain_and_silent_tags_go():
    h = random_history(np.random.default_rng(8))
    heard = h.heard.copy()
    heard[h.tag == 0] = False
    rest = h.replace(heard=heard, covariates={"a": np.arange(19.0)}).detected()
    assert rest.tags == ("t1",) and rest.n_heard.min() > 0
    assert rest.covariates["a"].tolist() == (12 + np.flatnonzero(heard[12:].any(1))).tolist()
    assert h.without_schedule().schedule.kind == "unknown"


def test_listening_follows_the_deployments():
    r = receivers(start=np.full(6, START + 5 * 10**9), end=np.full(6, START + 10 * 10**9))
    h = random_history(np.random.default_rng(9), receivers=r, origin=START)
    expected = ((h.time >= 5) & (h.time < 10))[:, None] | h.heard
    np.testing.assert_array_equal(h.listening, expected)


# -- model arrays -----------------------------------------------------------------------------


def test_tags_lie_end_to_end_and_padding_is_nobody():
    h = random_history(np.random.default_rng(10))
    d = to_model_data(h)
    s, real = 24, 19
    assert d.time.shape == (s,) and d.dt.shape == (s - 1,) and d.heard.shape == (s, 8)
    assert np.asarray(d.tag).tolist() == [0] * 12 + [1] * 7 + [2] * 5 and d.n_tags == 2
    steps = np.asarray(d.dt)
    same = np.diff(np.asarray(d.tag)) == 0
    np.testing.assert_allclose(steps[same][: real - 2], np.diff(h.time)[np.diff(h.tag) == 0])
    assert (steps[~same] == 1).all()
    assert not np.asarray(d.listening)[real:].any() and not np.asarray(d.listening)[:, 6:].any()
    np.testing.assert_array_equal(np.asarray(d.heard)[:real, :6], h.heard)
    np.testing.assert_array_equal(np.asarray(d.near_xy)[3, :6], XY)
    bare = to_model_data(h, pad=False)
    assert bare.time.shape == (real,) and bare.heard.shape == (real, 6)


def test_starts_are_the_middles_of_the_hearers():
    heard = np.zeros((3, 6), bool)
    heard[0, :2], heard[2, 4:] = True, True
    h = EncounterHistory([0.0, 1.0, 4.0], [0, 0, 0], heard, receivers())
    start = np.asarray(to_model_data(h, pad=False).initial)
    np.testing.assert_allclose(start, [[0, 150], [150, 150], [600, 150]])


def test_covariates_are_standardised_over_what_listened():
    rng = np.random.default_rng(11)
    depth = rng.uniform(1, 9, 6)
    wind = rng.normal(size=19)
    h = random_history(rng, receivers=receivers(depth=depth), origin=START)
    noise = covariates.readings(
        START + np.array([0, 0, 30], np.int64) * 10**9, ["R0", "R1", "R1"], [1.0, 2.0, 5.0],
        h.receivers, START,
    )  # fmt: skip
    day = covariates.time_of_day(START, period=10.0)
    given = {"depth": covariates.receiver_depth(h.receivers), "wind": wind, "noise": noise, **day}
    got = np.asarray(to_model_data(h.replace(covariates=given), pad=False).covariates)
    assert got.shape == (19, 6, 5)
    np.testing.assert_allclose(
        got[:, :, 0], np.broadcast_to((depth - depth.mean()) / depth.std(), (19, 6))
    )
    np.testing.assert_allclose(got[:, 2, 1], (wind - wind.mean()) / wind.std())
    raw = np.column_stack([np.full(19, 1.0), 2 + np.minimum(h.time, 30) / 10])
    np.testing.assert_allclose(got[:, :2, 2], (raw - raw.mean()) / raw.std())
    assert (got[:, 2:, 2] == 0).all()
    angle = np.sin(2 * np.pi * h.time / 10)
    np.testing.assert_allclose(got[:, 0, 3], (angle - angle.mean()) / angle.std())
    with pytest.raises(InputError, match="one value everywhere"):
        to_model_data(h.replace(covariates={"a": np.ones(6)}))
    with pytest.raises(InputError, match="'a' has shape"):
        to_model_data(h.replace(covariates={"a": np.ones(5)}))


# -- pruning ----------------------------------------------------------------------------------


def log_likelihood(data, position, p0, scale, lost):
    """Sum over states of the log probability of who heard, by the arrays of a model."""
    away = np.linalg.norm(np.asarray(data.near_xy) - position[:, None], axis=-1)
    p = p0 * np.exp(-0.5 * (away / scale) ** 2)
    heard, listening = np.asarray(data.heard), np.asarray(data.listening)
    each = np.where(listening, np.where(heard, p, 1 - p), 1.0).prod(axis=1)
    return np.log((1 - lost) * each + lost * ~heard.any(axis=1)).sum()


@pytest.mark.parametrize("reach", [350.0, 500.0, 700.0])
def test_pruning_changes_the_likelihood_by_less_than_its_bound(reach):
    rng = np.random.default_rng(12)
    h = random_history(rng, schedule=Schedule(), known=True)
    near = rng.uniform(0, 300, (19, 2))
    few = h.prune(near, reach=reach)
    bound = prune_bound(few, 150.0, 0.9, margin=80.0)
    full, less = to_model_data(h, pad=False), to_model_data(few, pad=False)
    assert np.asarray(less.listening).sum() < 19 * 6 or reach == 700
    assert np.asarray(less.heard).sum() == h.heard.sum()
    worst = 0.0
    for _ in range(50):
        angle = rng.uniform(0, 2 * np.pi, 19)
        position = near + 80 * np.column_stack([np.cos(angle), np.sin(angle)])
        for lost in (0.0, 0.3):
            gap = log_likelihood(less, position, 0.9, 150.0, lost)
            worst = max(worst, abs(gap - log_likelihood(full, position, 0.9, 150.0, lost)))
    assert worst <= bound
    assert worst > 0.02 * bound > 0 or reach == 700
    assert prune_bound(h, 150.0) == 0


def test_intervals_stated_without_the_pings_length_are_pointed_out():
    rng = np.random.default_rng(13)
    right, *_ = study(rng, n=60)
    h = encounter_history(right, receivers(), schedule=Schedule("random", 20, 40))
    assert not h.report.warnings
    longer, *_ = study(rng, n=60, interval=(23.5, 43.5), p=0.8)
    h = encounter_history(longer, receivers(), schedule=Schedule("random", 20, 40))
    assert "a little above the longest interval, 40 s" in h.report.warnings[0].text


# -- gaps -------------------------------------------------------------------------------------


def test_gaps_lie_between_pings_and_leads_are_cut():
    h = EncounterHistory(
        [10.0, 12.0, 20.0, 5.0], [0, 0, 0, 1], np.ones((4, 6), bool), receivers(), ("a", "b"),
        Schedule("random", 1, 2), start=[9.5, -50.0], end=[30.0, np.nan], first_at_start=True,
        lead=4.0,
    )  # fmt: skip
    gaps = [(g.kind, g.tag, g.start, g.duration, g.first_at_start) for g in find_gaps(h)]
    assert gaps == [
        ("before", 0, 9.5, 0.5, True),
        ("inside", 0, 10.0, 2.0, False),
        ("inside", 0, 12.0, 8.0, False),
        ("after", 0, 20.0, 6.0, False),
        ("before", 1, -1.0, 6.0, False),
    ]
    assert [most_missed(h, g) for g in find_gaps(h)] == [1, 1, 7, 6, 7]
    assert find_gaps(h.replace(known=True)) == [] == find_gaps(h.replace(schedule=Schedule()))
    bare = h.replace(start=[np.nan] * 2, end=[np.nan] * 2)
    assert [g.kind for g in find_gaps(bare)] == ["inside", "inside"]


def test_states_are_pings_and_the_nodes_of_the_gaps():
    h = EncounterHistory(
        [10.0, 11.5, 17.0, 2.0], [0, 0, 0, 1], np.ones((4, 6), bool), receivers(), ("a", "b"),
        Schedule("random", 1, 2), start=[4.0, np.nan], end=[23.0, np.nan], lead=3.0,
    )  # fmt: skip
    states = chain(h)
    assert states.row[states.row >= 0].tolist() == [0, 1, 2, 3]
    assert (np.diff(states.time)[np.diff(states.tag) == 0] > 0).all()
    assert states.time[0] == 10 - 4.5 and states.time[states.tag == 0][-1] == 17 + 4.5
    law = interval_law(h.schedule)
    for gap, nodes, at in states.gaps:
        np.testing.assert_array_equal(nodes, gap_nodes(gap.duration, gap.kind, law))
        np.testing.assert_allclose(states.time[at], gap.start + nodes)
        assert (states.tag[at] == gap.tag).all()
    assert [len(nodes) for _, nodes, _ in states.gaps][1] == 0  # 1.5 s: no ping fits in
    d = to_model_data(h)
    ping = np.asarray(d.ping)
    assert ping.sum() == 4 and not np.asarray(d.heard)[~ping].any()
    real = np.asarray(d.valid)
    assert np.asarray(d.listening)[real, :6].all() and real.sum() == len(states.time)
    assert np.asarray(d.gaps.valid).sum() == 4


@pytest.mark.compiles
def test_pruning_in_gaps_changes_their_likelihood_by_less_than_the_bound():
    rng = np.random.default_rng(14)
    heard = np.tile([True] * 4 + [False] * 2, (6, 1))
    time = np.cumsum([0, 1.2, 4.7, 1.8, 6.3, 3.1])
    h = random_history(rng, n=(6,), time=time, heard=heard, schedule=Schedule("random", 1, 2))
    near = rng.uniform(0, 200, (6, 2))
    few = h.prune(near, reach=450.0)
    full, less = to_model_data(h, pad=False), to_model_data(few, pad=False)
    states = chain(h)
    at = interpolate(h, states, near)

    def total(data):
        away = np.linalg.norm(np.asarray(data.near_xy) - at[:, None], axis=-1)
        p = 0.8 * np.exp(-0.5 * (away / 200) ** 2)
        log_q = np.log(np.where(np.asarray(data.listening), 1 - p, 1.0)).sum(axis=1)
        here = log_likelihood(data, at, 0.8, 200.0, 0.0)
        here -= log_q[states.row < 0].sum()  # nodes are no pings
        return here + float(np.asarray(gap_log_likelihood(data.gaps, log_q)).sum())

    change = abs(total(full) - total(less))
    assert 0 < change <= prune_bound(few, 200.0, 0.8)
