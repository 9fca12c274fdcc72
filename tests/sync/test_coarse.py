import numpy as np
import pytest

from maloc.sync._coarse import align


def record(seed, offset, drift, interval=(60.0, 100.0), hours=6.0, jump=0.0, missing=0.4):
    """Emissions of 4 tags as two receivers' clocks had them; receiver 0 is right."""
    rng = np.random.default_rng(seed)
    rows = []
    for tag in range(4):
        n = int(hours * 3600 / np.mean(interval))
        t = rng.uniform(0, 60) + np.cumsum(rng.uniform(interval[0], interval[1], n))
        for receiver in range(2):
            heard = rng.random(len(t)) > missing
            late = np.where(rng.random(len(t)) < 0.2, rng.uniform(0.02, 0.2, len(t)), 0.0)
            own = t + late
            if receiver:
                own = own + offset + drift * t + jump * (t > hours * 2400)
            rows.append(
                np.column_stack([own, np.full(len(t), tag), np.full(len(t), receiver)])[heard]
            )
    own, tag, receiver = np.concatenate(rows).T
    return own, tag.astype(int), receiver.astype(int)


@pytest.mark.parametrize("offset", [0.3, -12.5, 3600.04, -7200.35, 80_000.0])
@pytest.mark.parametrize("drift", [0.0, 4e-5, -7e-4])
def test_offsets_of_a_day_and_drifts_of_a_minute_a_day(offset, drift):
    clocks = align(*record(1, offset, drift), 2, 0)
    t = np.linspace(600, 6 * 3600 - 600, 20)
    error = clocks[1].at(t + offset + drift * t) - (offset + drift * t)
    assert np.abs(error).max() < 0.05
    assert clocks[1].jumps == []
    assert not clocks[1].ambiguous


def test_regular_tags_are_told_apart_by_their_jitter():
    clocks = align(*record(2, 1800.0, 1e-5, interval=(299.9, 300.1), hours=24.0), 2, 0)
    t = np.linspace(0, 80_000, 9)
    assert np.abs(clocks[1].at(t + 1800) - (1800 + 1e-5 * t)).max() < 0.05


def test_perfectly_regular_tags_are_called_ambiguous():
    clocks = align(*record(2, 0.2, 1e-5, interval=(300.0, 300.0), hours=24.0), 2, 0)
    assert clocks[1].ambiguous
    assert abs(clocks[1].at(np.array([40_000.0]))[0] - 0.6) < 0.05  # the smallest was taken


@pytest.mark.parametrize("jump", [0.8, 30.0, -3600.0])
def test_both_sides_of_a_jump_are_aligned(jump):
    own, tag, receiver = record(3, 5.0, 1e-5, hours=24.0, jump=jump)
    clocks = align(own, tag, receiver, 2, 0)
    clock, at = clocks[1], 24 * 2400.0
    [(time, size)] = clock.jumps
    assert size == pytest.approx(jump, abs=0.05)
    assert abs(time - at) < 1800
    for stretch, lead in zip(clock.stretches, (0.0, jump), strict=True):
        offset = stretch.at(own[stretch.rows])
        t = own[stretch.rows] - offset
        assert np.abs(offset - (5.0 + lead + 1e-5 * t)).max() < 0.05
        right = (t > at - 60) if lead else (t < at + 60)
        assert right.mean() > 0.99  # the rest matched by chance
    rows = np.concatenate([s.rows for s in clock.stretches])
    assert len(np.unique(rows)) == len(rows)
    assert (receiver[rows] == 1).all()


def test_a_silence_is_no_jump():
    own, tag, receiver = record(6, 5.0, 3e-5, hours=24.0)
    keep = (receiver == 0) | (own < 30_000) | (own > 60_000)
    clock = align(own[keep], tag[keep], receiver[keep], 2, 0)[1]
    assert clock.jumps == []
    assert len(clock.stretches[0].rows) == (receiver[keep] == 1).sum()


def test_unrelated_records_are_not_aligned():
    own, tag, receiver = record(4, 5.0, 0.0, hours=2.0)
    rng = np.random.default_rng(0)
    other = receiver == 1
    own[other] = np.sort(rng.uniform(0, 7200, other.sum()))
    assert list(align(own, tag, receiver, 2, 0)) == [0]
