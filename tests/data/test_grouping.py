"""Grouping of detections into pings, against simulations whose pings are known."""

import numpy as np
import pytest

from maloc.data import Detections, Receivers, Schedule, toa_matrix
from maloc.data._pings import echoes
from maloc.errors import InputError

C = 1480.0
START = 1_622_548_800 * 10**9


def simulate(rng, xy, n, interval, *, p_heard=0.8, p_late=0.0, p_echo=0.0, speed=1.0, noise=0.0005):
    """Detections and, for each, its ping, and whether it is an echo of an earlier one."""
    span = np.ptp(xy, axis=0).max()
    emission = np.cumsum(rng.uniform(*interval, n)) + 5
    heading = np.cumsum(rng.normal(0, 0.2, n))
    step = speed * np.diff(emission, prepend=emission[0])[:, None]
    track = xy.mean(0) + rng.uniform(-0.3, 0.3, 2) * span
    track = track + np.cumsum(step * np.column_stack([np.cos(heading), np.sin(heading)]), 0)
    distance = np.hypot(*(track[:, None] - xy[None]).transpose(2, 0, 1))
    time = emission[:, None] + distance / C + rng.normal(0, noise, distance.shape)
    time = time + (rng.random(time.shape) < p_late) * rng.uniform(0.02, 0.2, time.shape)
    heard = rng.random(time.shape) < p_heard
    ping, receiver = np.nonzero(heard)
    t, echo = time[heard], np.zeros(len(ping), bool)
    again = np.flatnonzero(rng.random(len(t)) < p_echo)
    t = np.concatenate([t, t[again] + rng.uniform(0.02, 0.2, len(again))])
    ping, receiver = (np.concatenate([v, v[again]]) for v in (ping, receiver))
    echo = np.concatenate([echo, np.ones(len(again), bool)])
    mixed = rng.permutation(len(t))
    t, ping, receiver, echo = t[mixed], ping[mixed], receiver[mixed], echo[mixed]
    names = np.array([f"R{i}" for i in range(len(xy))])
    d = Detections(
        START + np.rint(t * 1e9).astype(np.int64), names[receiver], np.full(len(t), "A69-1602-1")
    )
    return d, Receivers(names, xy[:, 0], xy[:, 1]), ping, echo


def share_right(toa, ping, echo):
    """Share of direct detections whose row holds exactly the detections of one true ping."""
    right = 0
    for row in toa.detection:
        rows = row[row >= 0]
        owners = np.unique(ping[rows])
        if len(owners) == 1 and len(rows) == ((ping == owners[0]) & ~echo).sum():
            right += len(rows)
    return right / (~echo).sum()


ARRAYS = {
    "pond": (np.array([[0, 0], [60, 0], [30, 50], [10, 80.0]]), (2.0, 4.0), 1.0),
    "bay": (np.random.default_rng(5).uniform(0, 400, (12, 2)), (20, 40), 1.0),
    "wide": (np.random.default_rng(6).uniform(0, 5000, (14, 2)), (20, 40), 1.0),
    "wide, short interval": (np.random.default_rng(7).uniform(0, 4000, (10, 2)), (3, 6), 0.97),
    "wide, interval near its width": (
        np.random.default_rng(8).uniform(0, 3000, (10, 2)), (1.5, 3), 0.97),
    "river": (np.column_stack([np.arange(40) * 500.0, np.zeros(40)]), (8, 15), 0.97),
}  # fmt: skip


@pytest.mark.parametrize("name", ARRAYS)
@pytest.mark.parametrize("seed", range(3))
def test_pings_are_put_together_again(name, seed):
    xy, interval, least = ARRAYS[name]
    rng = np.random.default_rng(100 + seed)
    d, r, ping, echo = simulate(rng, xy, 150, interval, p_late=0.15, p_echo=0.2)
    toa = toa_matrix(d, r, "1", sound_speed=C)
    assert share_right(toa, ping, echo) >= least
    assert toa.detection is not None
    used = toa.detection[toa.heard]
    assert len(np.unique(used)) == len(used)
    assert sorted([*used, *toa.set_aside.detection]) == list(range(len(d)))
    assert toa.origin == START + int(d.time.min() - START) // 10**9 * 10**9
    np.testing.assert_allclose(toa.toa[toa.heard], (d.time[used] - toa.origin) / 1e9, atol=1e-12)
    assert (toa.receivers.receiver[np.nonzero(toa.heard)[1]] == d.receiver[used]).all()


def test_echoes_are_set_aside_with_their_delay():
    d, r, ping, echo = simulate(
        np.random.default_rng(3), ARRAYS["bay"][0], 200, (20, 40), p_echo=0.5, p_heard=0.5
    )
    toa = toa_matrix(d, r, "1", sound_speed=C)
    assert sorted(toa.set_aside.detection) == np.flatnonzero(echo).tolist()
    assert all(w.startswith("echo, ") for w in toa.set_aside.why)
    assert any(n.count == int(echo.sum()) for n in toa.report.notes)


def brute_echoes(time, column, window):
    out, head = [], {}
    for i, (t, c) in enumerate(zip(time, column, strict=True)):
        if c in head and t - time[head[c]] < window:
            out.append(head[c])
        else:
            head[c] = i
            out.append(-1)
    return out


@pytest.mark.parametrize("seed", range(20))
def test_echoes_equal_the_obvious_loop(seed):
    rng = np.random.default_rng(seed)
    time = np.sort(rng.uniform(0, 10, 60))
    column = rng.integers(0, 4, 60)
    assert echoes(time, column, 0.5).tolist() == brute_echoes(time, column, 0.5)


def test_missed_pings_and_lone_detections_are_kept():
    d, r, ping, echo = simulate(
        np.random.default_rng(4), ARRAYS["bay"][0], 300, (20, 40), p_heard=0.2
    )
    toa = toa_matrix(d, r, "1", sound_speed=C)
    assert toa.n_pings == len(np.unique(ping))
    assert (toa.n_heard == 1).sum() == (np.bincount(ping) == 1).sum() > 0
    assert share_right(toa, ping, echo) == 1.0


def test_schedule_exposes_false_lone_detections():
    d, r, ping, echo = simulate(np.random.default_rng(9), ARRAYS["bay"][0], 40, (20, 40))
    false = d.time.min() + np.array([63, 187, 401], np.int64) * 10**9 // 1
    true = np.sort([d.time[ping == p].min() for p in np.unique(ping)])
    gap = np.abs(false[:, None] - true[None]).min(1) / 1e9
    assert (gap < 18).all() and (gap > 1).all()
    everything = Detections(
        np.concatenate([d.time, false]),
        np.concatenate([d.receiver, ["R1", "R2", "R3"]]),
        np.full(len(d) + 3, "A69-1602-1"),
    )
    loose = toa_matrix(everything, r, "1", sound_speed=C)
    firm = toa_matrix(everything, r, "1", sound_speed=C, schedule=Schedule("random", 20, 40))
    assert loose.n_pings == firm.n_pings + 3
    assert sorted(firm.set_aside.detection) == [len(d), len(d) + 1, len(d) + 2]
    assert share_right(firm, np.append(ping, [-1, -2, -3]), np.append(echo, [True] * 3)) == 1.0


@pytest.mark.parametrize("offsets", [(0, 0.9, -2.3), (0, 3600, -7200), (0, 40.0, 11.0)])
def test_clocks_apart_are_refused(offsets):
    d, r, ping, _ = simulate(np.random.default_rng(2), ARRAYS["bay"][0], 100, (20, 40))
    shift = {f"R{i}": offsets[i % 3] + 0.7 * (i // 3) * bool(offsets[i % 3]) for i in range(12)}
    off = np.array([round(shift[str(n)] * 1e9) for n in d.receiver])
    with pytest.raises(InputError, match="clocks look unsynchronised"):
        toa_matrix(Detections(d.time + off, d.receiver, d.tag), r, "1", sound_speed=C)


def test_one_bad_clock_is_named_and_the_rest_used():
    d, r, ping, _ = simulate(np.random.default_rng(2), ARRAYS["bay"][0], 100, (20, 40))
    off = np.where(d.receiver == "R5", 7 * 10**9, 0)
    toa = toa_matrix(Detections(d.time + off, d.receiver, d.tag), r, "1", sound_speed=C)
    assert any("clock of R5 looks wrong" in n.text for n in toa.report.warnings)


def test_what_cannot_be_positioned_is_refused():
    d, r, _, _ = simulate(np.random.default_rng(2), ARRAYS["bay"][0], 20, (20, 40))
    whole = Detections(d.time // 10**9 * 10**9, d.receiver, d.tag)
    with pytest.raises(InputError, match="whole seconds"):
        toa_matrix(whole, r, "1")
    with pytest.raises(InputError, match="heard by 1 receiver"):
        toa_matrix(d.select(receiver="R1"), r, "1")
    with pytest.raises(InputError, match="no detection of tag .* of the table"):
        toa_matrix(Detections(d.time, np.char.add("X", d.receiver), d.tag), r, "1")
    with pytest.raises(InputError, match="no tag '2'"):
        toa_matrix(d, r, "2")
    with pytest.raises(InputError, match="sound speed"):
        toa_matrix(d, r, "1", sound_speed=np.nan)
    with pytest.raises(InputError, match="there are 20 pings"):
        toa_matrix(d, r, "1", sound_speed=np.full(7, C))


def test_order_of_detections_and_receivers_does_not_matter():
    d, r, _, _ = simulate(np.random.default_rng(8), ARRAYS["wide"][0], 60, (20, 40), p_late=0.2)
    a = toa_matrix(d, r, "1", sound_speed=C)
    rng = np.random.default_rng(1)
    rows, columns = rng.permutation(len(d)), rng.permutation(len(r))
    b = toa_matrix(
        Detections(d.time[rows], d.receiver[rows], d.tag[rows]), r.subset(columns), "1",
        sound_speed=np.full(a.n_pings, C),
    )  # fmt: skip
    np.testing.assert_array_equal(b.toa, a.toa[:, columns])


def test_default_sound_speed_is_said():
    d, r, _, _ = simulate(np.random.default_rng(8), ARRAYS["bay"][0], 20, (20, 40))
    toa = toa_matrix(d, r, "1", origin=START)
    assert toa.origin == START and (toa.sound_speed == 1500).all()
    assert any("1500 m/s assumed" in n.text for n in toa.report.warnings)


def test_a_receiver_exported_without_fractions_is_set_aside():
    d, r, ping, echo = simulate(np.random.default_rng(8), ARRAYS["bay"][0], 60, (20, 40))
    bad = d.receiver == "R4"
    time = np.where(bad, d.time // 10**9 * 10**9, d.time)
    toa = toa_matrix(Detections(time, d.receiver, d.tag), r, "1", sound_speed=C)
    assert sorted(toa.set_aside.detection) == np.flatnonzero(bad).tolist()
    assert set(toa.set_aside.why) == {"whole-second time"}
    assert share_right(toa, ping, echo | bad) == 1.0
