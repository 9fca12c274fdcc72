import dataclasses

import numpy as np
import pytest

from maloc import sync
from maloc.data import Detections, Receivers
from maloc.errors import FitError, InputError
from tests.sync.simulated import ORIGIN, simulate


def offset_error(truth, fitted):
    """Error (N,) of the fitted offsets of all clocks but the reference's, s."""
    reference = fitted.receivers.names.index(fitted.reference)
    relative, inside = truth.relative(reference)
    got = fitted.offset(truth.detections.receiver, truth.detections.time)
    return (got - relative)[inside & (truth.clock != reference)]


def rms(x):
    return np.sqrt(np.mean(np.square(x)))


@pytest.mark.parametrize("seed", range(4))
def test_offsets_of_hours_curved_drift_and_reflections(seed):
    """8 receivers, a day, 15 % reflected, 30 % missing, .2 ms jitter and 1 ms rounding."""
    truth = simulate(seed, n_receivers=8, hours=24.0)
    fitted = sync.fit(truth.detections, truth.receivers)
    error = offset_error(truth, fitted)
    assert rms(error) < 3e-4
    assert np.abs(error).max() < 1.5e-3
    assert abs(fitted.sound_speed - truth.sound_speed) < 3 * fitted.sound_speed_sd + 0.1
    assert fitted.reflected == pytest.approx(truth.late.mean(), abs=0.02)
    assert len(fitted.jumps) == 0
    assert np.hypot(*fitted.shift.T).max() < 0.6
    r = fitted.residuals
    late = truth.late[r.row]
    assert r.used[late].mean() < 0.03
    assert r.used[~late].mean() > 0.95
    assert set(r.why) <= {
        "",
        "late: reflected",
        "early or wild",
        "ping heard by one receiver",
        "later arrival of the same ping",
    }


def test_standard_errors_cover():
    z = []
    for seed in range(4):
        truth = simulate(seed, hours=12.0)
        d = truth.detections
        fitted = sync.fit(d, truth.receivers, free_positions=0.0)
        reference = fitted.receivers.names.index(fitted.reference)
        relative, inside = truth.relative(reference)
        error = fitted.offset(d.receiver, d.time) - relative
        sd = fitted.offset_sd(d.receiver, d.time)
        rows = inside & (truth.clock != reference)
        z += list(error[rows][::20] / sd[rows][::20])
    assert len(z) > 400
    assert np.mean(np.abs(z) < 1.96) > 0.9
    assert 0.6 < rms(z) < 1.25


def test_standard_errors_grow_in_silence_and_beyond():
    truth = simulate(3, hours=12.0)
    d = truth.detections
    silent = (truth.clock == 2) & (truth.true > 4 * 3600) & (truth.true < 8 * 3600)
    fitted = sync.fit(d.select(mask=~silent), truth.receivers, reference="R000")
    relative, inside = truth.relative(0)
    sd, error = fitted.offset_sd(d.receiver, d.time), fitted.offset(d.receiver, d.time) - relative
    mine = (truth.clock == 2) & inside
    middle = mine & (np.abs(truth.true - 6 * 3600) < 1800)
    usual = np.median(sd[mine & ~silent])
    assert np.median(sd[middle]) > 3 * usual
    assert (np.abs(error[middle]) < 3 * sd[middle]).all()
    hours = d.time.max() + 3600 * 10**9 * np.array([0, 1, 3])
    ahead = fitted.offset_sd("R002", hours)
    assert (np.diff(ahead) > 0).all()
    assert ahead[2] > 10 * usual


def test_drift_of_a_minute_a_day_and_a_single_sync_tag():
    truth = simulate(1, n_tags=1, ppm=350.0, hours=12.0, interval=(40.0, 80.0))
    fitted = sync.fit(truth.detections, truth.receivers, sound_speed=truth.sound_speed)
    assert fitted.synced.all()  # the tag's own receiver by its own tag, having no other
    assert rms(offset_error(truth, fitted)) < 3e-4
    assert fitted.sound_speed_sd == 0
    loose = sync.fit(truth.detections, truth.receivers)
    assert any("hardly tell the sound speed" in n.text for n in loose.notes)


def test_reference_is_a_gauge():
    truth = simulate(2, hours=6.0)
    d = truth.detections
    by = {
        ref: sync.fit(truth.detections, truth.receivers, reference=ref) for ref in ("R000", "R004")
    }
    assert [f.reference for f in by.values()] == ["R000", "R004"]
    offsets = [f.offset(d.receiver, d.time) for f in by.values()]
    # the difference is the reference's offset at that moment, the same for all receivers
    order = np.argsort(truth.true)
    common = (offsets[0] - offsets[1])[order]
    smooth = np.polyval(np.polyfit(truth.true[order], common, 5), truth.true[order])
    assert np.abs(common - smooth).max() < 3e-4
    np.testing.assert_allclose(by["R000"].shift, by["R004"].shift, atol=0.02)
    assert by["R000"].sound_speed == pytest.approx(by["R004"].sound_speed, abs=0.1)


def test_frame_clock_and_order_do_not_matter():
    truth = simulate(3, hours=2.0)
    plain = sync.fit(truth.detections, truth.receivers, reference="R000")
    a = np.deg2rad(40.0)
    turn = np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
    xy = truth.receivers.xy @ turn.T + [5e5, 3e6]
    shuffle = np.random.default_rng(0).permutation(6)
    turned = dataclasses.replace(truth.receivers, x=xy[:, 0], y=xy[:, 1]).subset(shuffle)
    rows = np.random.default_rng(1).permutation(len(truth.detections))
    mixed = dataclasses.replace(
        truth.detections,
        time=truth.detections.time[rows] + 86_400 * 10**9,
        receiver=truth.detections.receiver[rows],
        tag=truth.detections.tag[rows],
    )
    other = sync.fit(mixed, turned, reference="R000")
    np.testing.assert_allclose(
        other.offset(mixed.receiver, mixed.time),
        plain.offset(truth.detections.receiver, truth.detections.time)[rows],
        atol=2e-6,
    )
    np.testing.assert_allclose(other.shift, (plain.shift @ turn.T)[shuffle], atol=2e-3)
    np.testing.assert_array_equal(np.sort(other.residuals.row), np.sort(plain.residuals.row))


def test_places_wrong_by_a_metre_give_way():
    truth = simulate(4, n_receivers=9, hours=6.0)
    noise = np.random.default_rng(0).normal(0, 1.0, (9, 2))
    table = dataclasses.replace(
        truth.receivers, x=truth.receivers.x + noise[:, 0], y=truth.receivers.y + noise[:, 1]
    )
    free = sync.fit(truth.detections, table)
    held = sync.fit(truth.detections, table, free_positions=0.0)
    assert free.sigma < 4e-4
    assert held.sigma > 1.5 * free.sigma
    assert (held.shift == 0).all()
    np.testing.assert_array_equal(held.receivers.xy, table.xy)
    np.testing.assert_allclose(free.receivers.xy, table.xy + free.shift)
    # what matters for positions: distances between receivers
    i, j = np.triu_indices(9, 1)

    def lengths(xy):
        return np.hypot(*(xy[i] - xy[j]).T)

    right = lengths(truth.receivers.xy)
    assert rms(lengths(free.receivers.xy) - right) < 0.6 * rms(lengths(table.xy) - right)


@pytest.mark.parametrize("size", [100.0, -100.0, 0.025])
def test_clock_that_jumps_is_followed(size):
    truth = simulate(1, hours=24.0)
    jumped = (truth.clock == 3) & (truth.true > 9 * 3600)
    time = truth.detections.time + np.where(jumped, round(size * 1e9), 0)
    raw = dataclasses.replace(truth.detections, time=time)
    fitted = sync.fit(raw, truth.receivers, reference="R000")
    assert fitted.jumps.receiver.tolist() == ["R003"]
    assert fitted.jumps.size[0] == pytest.approx(size, abs=5e-4)
    assert fitted.jumps.size_sd[0] < 5e-4
    assert any("R003 jumps by" in n.text for n in fitted.notes)
    relative, _ = truth.relative(0)
    r = fitted.residuals
    error = (r.offset - (relative + size * jumped)[r.row])[np.isfinite(r.offset)]
    assert rms(error) < 3e-4
    assert np.abs(error).max() < 1.5e-3
    own = np.sort(truth.true[truth.clock == 3])
    before, after = own[own < 9 * 3600][-6], own[own > 9 * 3600][5]
    common = fitted.jumps.time[0] - (truth.offset[truth.clock == 0]).mean()
    shift = (fitted.origin - ORIGIN) * 1e-9
    assert before - 1 < common + shift < after + 1
    # what the table of times alone can tell is applied, the rest is set aside and counted
    common = fitted.apply(raw)
    lost = len(raw) - len(common)
    said = [n.count for n in common.report.notes if "R003" in n.text and "set aside" in n.text]
    assert lost == sum(said)
    assert lost < (20 if size > -1 else 40)
    assert (common.receiver == "R003").sum() == (raw.receiver == "R003").sum() - lost


def test_reference_that_jumps_is_seen_as_the_one():
    truth = simulate(2, hours=24.0)
    jumped = (truth.clock == 0) & (truth.true > 14 * 3600)
    time = truth.detections.time + np.where(jumped, 30 * 10**9, 0)
    raw = dataclasses.replace(truth.detections, time=time)
    fitted = sync.fit(raw, truth.receivers, reference="R000")
    assert fitted.jumps.receiver.tolist() == ["R000"]
    assert fitted.jumps.size[0] == pytest.approx(30.0, abs=5e-4)
    chosen = sync.fit(raw, truth.receivers)
    assert chosen.reference != "R000"
    assert chosen.jumps.receiver.tolist() == ["R000"]


def test_receivers_that_cannot_be_synchronised_are_named_and_set_aside():
    truth = simulate(0, n_receivers=6, hours=2.0, n_tags=5)
    d, table = truth.detections, truth.receivers
    rng = np.random.default_rng(0)
    wild = d.receiver == "R005"  # its times are noise
    time = d.time.copy()
    time[wild] = rng.integers(time.min(), time.max(), wild.sum())
    more = Detections(time[:1] + 5 * 10**9, np.array(["R999"]), d.tag[:1])
    raw = Detections.concat([dataclasses.replace(d, time=time), more])
    table = Receivers(
        np.r_[table.receiver, ["deaf"]],
        np.r_[table.x, 0.0],
        np.r_[table.y, 900.0],
        sync_tag=np.r_[table.sync_tag, ["777"]],
    )
    fitted = sync.fit(raw, table)
    said = "\n".join(n.text for n in fitted.notes)
    assert "777 (receiver deaf)" in said
    assert "heard no sync tag, not synchronised: deaf" in said
    assert "receiver R005 not synchronised" in said
    assert "1 sync detections by a receiver that is not in the table" in said
    assert fitted.synced.tolist() == [True] * 5 + [False] * 2
    assert np.isnan(fitted.offset("R005", raw.time[0]))[0]
    common = fitted.apply(raw)
    assert set(common.receivers) == {f"R00{i}" for i in range(5)}
    aside = [n for n in common.report.notes if "not synchronised (R005, R999)" in n.text]
    assert [n.count for n in aside] == [wild.sum() + 1]


def test_moved_receiver_has_two_places_and_one_clock():
    truth = simulate(5, hours=8.0, self_detections=False, reflected=0.0)
    at = truth.detections.time.min() + 4 * 3600 * 10**9
    t = truth.receivers
    base = int(np.median(truth.offset[truth.clock == 5]) * 1e9)
    # receiver 5 was nominally moved: same place, described by two deployments
    table = Receivers(
        np.r_[t.receiver, ["R005"]],
        np.r_[t.x, t.x[5]],
        np.r_[t.y, t.y[5]],
        sync_tag=np.r_[t.sync_tag, [t.sync_tag[5]]],
        start=np.r_[[np.iinfo(np.int64).min] * 6, [at + base]],
        end=np.r_[[np.iinfo(np.int64).max] * 5, [at + base], [np.iinfo(np.int64).max]],
    )
    fitted = sync.fit(truth.detections, table, reference="R000", free_positions=0.0)
    assert fitted.values.shape[0] == 6
    assert fitted.shift.shape == (7, 2)
    assert rms(offset_error(truth, fitted)) < 3e-4


class TestBadInput:
    truth = simulate(0, n_receivers=4, hours=1.0, interval=(40.0, 60.0))

    def test_no_sync_tag_in_the_table(self):
        t = self.truth.receivers
        with pytest.raises(InputError, match="no receiver has a sync tag"):
            sync.fit(self.truth.detections, Receivers(t.receiver, t.x, t.y))

    def test_no_sync_tag_heard(self):
        t = dataclasses.replace(self.truth.receivers, sync_tag=np.array(["1", "2", "3", "4"]))
        with pytest.raises(InputError, match="none of the 4 sync tags was detected"):
            sync.fit(self.truth.detections, t)

    def test_one_tag_at_two_places(self):
        t = dataclasses.replace(self.truth.receivers, sync_tag=np.array(["60000"] * 2 + [""] * 2))
        with pytest.raises(InputError, match="two places at once: R000 and R001"):
            sync.fit(self.truth.detections, t)

    def test_ambiguous_number(self):
        d = self.truth.detections
        tag = d.tag.astype("U20")
        tag[:5] = "A69-9001-60000"
        with pytest.raises(InputError, match="ambiguous"):
            sync.fit(dataclasses.replace(d, tag=tag), self.truth.receivers)

    def test_unknown_reference(self):
        with pytest.raises(InputError, match="reference receiver 'X'"):
            sync.fit(self.truth.detections, self.truth.receivers, reference="X")

    @pytest.mark.parametrize(
        "option",
        [
            {"sound_speed": 1.5},
            {"knot_spacing": 0.0},
            {"free_positions": -1.0},
            {"free_positions": [1.0, -1.0, 1.0, 1.0]},
        ],
    )
    def test_options_that_make_no_sense(self, option):
        with pytest.raises(InputError, match=f"{next(iter(option))} must be at least"):
            sync.fit(self.truth.detections, self.truth.receivers, **option)

    def test_no_detections(self):
        with pytest.raises(InputError, match="no detections"):
            sync.fit(Detections.concat([]), self.truth.receivers)

    def test_nothing_in_common(self):
        d = self.truth.detections
        rng = np.random.default_rng(0)
        time = np.sort(rng.integers(d.time.min(), d.time.min() + 3600 * 10**9, len(d)))
        noise = dataclasses.replace(d, time=time)
        with pytest.raises(FitError, match="no clock could be aligned"):
            sync.fit(noise, self.truth.receivers)
