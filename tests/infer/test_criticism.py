"""Checks of what a fit was given: their scores against dense algebra, their p values, their aim."""

import dataclasses

import numpy as np
import pytest

import maloc
from maloc._jax import jax, jnp
from maloc.errors import InputError, MalocWarning
from maloc.infer import _array_checks as array_checks
from maloc.infer import _input_scores as scores
from maloc.infer import _schedule_checks as schedule_checks
from maloc.infer.criticism import InputCheck, InputChecks
from maloc.infer.mode import find_mode
from maloc.models import toa_track
from tests.infer import cases


@pytest.fixture(scope="module")
def point(laplace_fit):
    return scores.fitted_point(laplace_fit)


class TestScores:
    def test_score_is_the_slope_of_the_log_density_with_the_path_refitted(self, point):
        args = point.args
        found = scores.score(point, scores.lens(point))
        step = 0.01
        for receiver, axis in ((1, 0), (4, 1)):
            ends = []
            for sign in (1, -1):
                xy = np.asarray(args[0].receiver_xy).copy()
                xy[receiver, axis] += sign * step
                there = (dataclasses.replace(args[0], receiver_xy=jnp.asarray(xy)),)
                ends.append(-find_mode(point.cm, there, point.x, point.u, tol=1e-12).value)
            slope = (ends[0] - ends[1]) / (2 * step)
            assert found[receiver, axis] == pytest.approx(slope, rel=1e-3, abs=1e-3)

    def test_information_is_the_schur_complement_of_the_dense_precision(self, point):
        cm, args, x, u = point.cm, point.args, point.x, point.u
        base = jnp.asarray(args[0].receiver_xy)

        def law(x, xy):
            moved = (dataclasses.replace(args[0], receiver_xy=xy),)
            return cm._trace(cm.sites(x, u)[0], moved)["arrival"]["fn"].base_dist

        def predicted(x, xy):
            return jnp.ravel(law(x, xy).loc)

        curvature = jax.jit(lambda x: law(x, base).curvature(args[0].range))(x)
        weight = (np.asarray(curvature) * np.asarray(args[0].heard)).ravel()
        by_path, by_shift = jax.jit(jax.jacfwd(predicted, argnums=(0, 1)))(jnp.asarray(x), base)
        by_path = np.asarray(by_path).reshape(weight.size, -1)
        by_shift = np.asarray(by_shift).reshape(weight.size, -1)
        n, d = by_path.shape[1], cm.d
        band = np.asarray(cm.terms(x, u, args, 0.0, False)[2])
        precision = np.zeros((n, n))
        for offset in range(2 * d):
            rows = np.arange(n - offset)
            precision[rows + offset, rows] = precision[rows, rows + offset] = band[
                offset, : len(rows)
            ]
        cross = by_path.T @ (weight[:, None] * by_shift)
        dense = by_shift.T @ (weight[:, None] * by_shift)
        dense -= cross.T @ np.linalg.solve(precision, cross)
        found = scores.lens(point).information
        np.testing.assert_allclose(found.reshape(dense.shape), dense, rtol=1e-6, atol=1e-8)
        assert np.linalg.eigvalsh(dense).min() > -1e-9

    def test_a_widened_score_is_that_of_the_widened_density(self, point):
        """At its own mode; and one step away from the mode it is what it is there."""
        there = find_mode(point.cm, point.args, point.x, point.u, temper=10.0, tol=1e-10).x
        at_mode, wide = point._replace(x=there), scores.lens(point, 10.0)
        step, ends = 0.01, []
        for sign in (1, -1):
            xy = np.asarray(point.args[0].receiver_xy).copy()
            xy[1, 0] += sign * step
            args = (dataclasses.replace(point.args[0], receiver_xy=jnp.asarray(xy)),)
            ends.append(find_mode(point.cm, args, there, point.u, temper=10.0, tol=1e-12).value)
        slope = (ends[1] - ends[0]) / (2 * step)
        assert scores.score(at_mode, wide)[1, 0] == pytest.approx(slope, rel=1e-3, abs=1e-4)
        size = np.sqrt(np.einsum("iaia->ia", wide.information)[1, 0])
        assert abs(scores.score(point, wide)[1, 0] - slope) < 0.3 * size

    def test_redrawn_arrivals_keep_the_hearing_pattern_and_the_law(self, point):
        data = point.args[0]
        law = point.cm._trace(point.cm.sites(point.x, point.u)[0], point.args)["arrival"]["fn"]
        off = []
        for key in jax.random.split(jax.random.key(0), 40):
            drawn = scores.redrawn(point, key)[0]
            np.testing.assert_array_equal(drawn.heard, data.heard)
            assert np.all(np.asarray(drawn.range)[~np.asarray(data.heard)] == 0)
            residual = np.asarray(drawn.range - law.base_dist.loc)[np.asarray(data.heard)]
            off.append(residual)
        sigma = float(np.asarray(law.base_dist.sigma).ravel()[0])
        middle = np.median(np.abs(np.concatenate(off))) / 0.6745
        assert middle == pytest.approx(sigma, rel=0.25)  # a few per cent are late

    @pytest.mark.extended
    def test_a_sampled_fit_counts_by_its_mean(self, sampled_fit, point):
        there = scores.fitted_point(sampled_fit)
        assert np.abs(there.u - point.u).max() < 1.0
        assert scores.score(there, scores.lens(there)).shape == (8, 2)


def _array(rng, n=6, simulations=49, inflation=1.0):
    """Scores that are normal, by a random information; all of them `inflation` times as wide."""
    root = rng.normal(size=(2 * n, 40))
    information = root @ root.T
    drawn = inflation * rng.multivariate_normal(np.zeros(2 * n), information, simulations + 1)
    drawn = drawn.reshape(-1, n, 2)
    xy = rng.normal(0, 100, (n, 2))
    return array_checks.Array(
        drawn[0], drawn[1:], information.reshape(n, 2, n, 2), xy.mean(axis=0) - xy
    )


class TestArray:
    @pytest.mark.parametrize("judge", [array_checks.judge_speed, array_checks.judge_receivers])
    @pytest.mark.parametrize("inflation", [1.0, 1.6])
    def test_false_alarms_are_as_rare_as_stated(self, judge, inflation):
        """Whatever the scores' true width: 400 clean cases at .05; beyond 10 to 32 one in 300."""
        rng = np.random.default_rng(3)
        found = [judge(_array(rng, inflation=inflation), 0.05) for _ in range(400)]
        flagged = sum(f.statistic >= f.threshold for f in found)
        assert flagged == sum(f.p <= 0.05 for f in found)
        assert 6 <= flagged <= 36

    def test_a_displacement_is_found_where_it_is(self):
        """Linear scores of receiver 2, 0.5 m off."""
        array = _array(np.random.default_rng(0))
        shift = np.zeros((6, 2))
        shift[2] = 0.9, -1.2
        moved = array._replace(score=np.einsum("iajb,jb->ia", array.information, shift))
        found = array_checks.judge_receivers(moved, 0.01)
        assert found.which == 2
        assert found.p < 1e-3
        assert np.abs(found.estimate - shift[2]).max() < 0.05

    def test_a_sound_speed_is_found_by_all_receivers(self):
        array = _array(np.random.default_rng(1), simulations=400)
        score = 0.02 * np.einsum("iajb,jb->ia", array.information, array.inward)
        found = array_checks.judge_speed(array._replace(score=score), 0.01)
        assert float(found.estimate) == pytest.approx(0.02, abs=4 * float(found.sd))
        assert found.p < 1e-3

    def test_what_is_free_explains_its_own_score_away(self):
        array = _array(np.random.default_rng(2))
        score = 0.02 * np.einsum("iajb,jb->ia", array.information, array.inward)
        rest = array_checks.without(array._replace(score=score), array.inward, 0.0)
        assert np.abs(rest.score).max() < 1e-9 * np.abs(score).max()
        along = np.einsum("ia,iajb->jb", array.inward, rest.information)
        assert np.abs(along).max() < 1e-9 * np.abs(array.information).max() * 300
        held = array_checks.without(array._replace(score=score), array.inward, 1e12)
        np.testing.assert_allclose(held.score, score, rtol=1e-4)


class TestSchedule:
    def test_misfit_by_brute_force(self):
        length = np.linspace(0.5, 150, 4000)
        lo, hi = 20.6, 36.6
        wanted = np.min(
            [np.maximum(m * lo - length, length - m * hi) for m in range(1, 40)], axis=0
        )
        found = schedule_checks._misfit(length, 0.0, lo, hi) + schedule_checks._TOLERANCE
        outside = wanted > 0
        np.testing.assert_allclose(found[outside], wanted[outside], atol=1e-12)
        assert np.all(found[~outside] <= 1e-12)

    def test_limits(self):
        rng = np.random.default_rng(0)
        n = rng.choice([1, 1, 1, 2, 3], 400)
        length = np.array([rng.uniform(20.6, 36.6, m).sum() for m in n])
        gaps = schedule_checks.Gaps(length, np.full(400, 1e-3), n)
        right = schedule_checks.outside_limits(gaps, 20.6, 36.6, 0.01, rng)
        assert not right.gaps.any()
        assert right.p == 1
        wrong = schedule_checks.outside_limits(gaps, 21.4, 35.8, 0.01, rng)
        single = (n == 1) & ((length < 21.4 - 0.253) | (length > 35.8 + 0.253))
        np.testing.assert_array_equal(wrong.gaps[n == 1], single[n == 1])
        assert wrong.gaps.sum() >= wrong.threshold == 3
        assert wrong.p < 0.01

    def test_gaps_that_are_hardly_known_are_no_evidence(self):
        rng = np.random.default_rng(0)
        gaps = schedule_checks.Gaps(np.full(50, 37.0), np.full(50, 0.5), np.ones(50))
        assert not schedule_checks.outside_limits(gaps, 20.6, 36.6, 0.01, rng).gaps.any()

    @pytest.mark.parametrize(("drift", "jitter"), [(0.0, 0.005), (0.003, 0.002)])
    def test_a_stable_interval_passes_drift_and_all(self, drift, jitter):
        rng = np.random.default_rng(1)
        each = 28.6 + np.cumsum(drift * rng.normal(size=600)) + jitter * rng.normal(size=600)
        sent = np.cumsum(each)[rng.random(600) < 0.6]
        length = np.diff(sent)
        gaps = schedule_checks.Gaps(length, np.full(len(length), 1e-3), np.zeros(len(length)))
        found = schedule_checks.spread_of_intervals(gaps, 28.6, 0.005, 0.01, rng)
        assert found.sd < 2 * max(jitter, drift) + 1e-3
        assert found.p > 0.05

    def test_a_random_interval_is_not_stable(self):
        rng = np.random.default_rng(2)
        length = rng.uniform(20.6, 36.6, 100)
        gaps = schedule_checks.Gaps(length, np.full(100, 1e-3), np.zeros(100))
        found = schedule_checks.spread_of_intervals(gaps, 28.6, 0.005, 0.01, rng)
        assert found.sd == pytest.approx(16 / np.sqrt(12), rel=0.3)
        assert found.sd > found.threshold
        assert found.p == 1e-3

    @pytest.mark.parametrize("kind", [pytest.param("random", marks=pytest.mark.extended), "stable"])
    def test_implied_gaps_are_the_true_ones(self, kind):
        """Even where the declared limits say something else."""
        times, emission, _ = cases.toa(kind=kind, unheard=())
        wrong = maloc.Schedule("random", 24.0, 26.0) if kind == "random" else times.schedule
        fit = maloc.infer.laplace(toa_track, times.replace(schedule=wrong))
        rng = np.random.default_rng(0)
        gaps = schedule_checks.implied_gaps(scores.fitted_point(fit), rng)
        assert gaps.length == pytest.approx(np.diff(emission), abs=0.01)
        assert np.all(gaps.sd < 0.01)


class TestCheckInputs:
    def test_table_and_rows(self, toa, laplace_fit):
        found = maloc.infer.check_inputs(laplace_fit, toa[0], simulations=15)
        assert [row.name for row in found.rows] == ["sound speed", "receiver positions"]
        assert found["receiver positions"].receiver in toa[0].receivers.labels
        assert len(str(found).splitlines()) == 3
        again = maloc.infer.check_inputs(laplace_fit, toa[0], simulations=15)
        assert str(again) == str(found)
        other = maloc.infer.check_inputs(laplace_fit, toa[0], simulations=15, seed=1)
        assert other["sound speed"].p != found["sound speed"].p

    @pytest.mark.parametrize("off", [pytest.param(8.0, marks=pytest.mark.extended), 25.0])
    def test_a_suspect_is_warned_of_by_name(self, off):
        """Off by so much that all that the receiver hears is taken for late, too."""
        times, _, _ = cases.toa(pings=30, unheard=(), p_late=0.0)
        r = times.receivers
        off = off * (np.arange(len(r)) == 2)
        moved = maloc.Receivers(r.receiver, r.x + off, r.y)
        fit = maloc.infer.laplace(toa_track, times.replace(receivers=moved))
        with pytest.warns(MalocWarning, match="receiver positions: R2 stands"):
            found = maloc.infer.check_inputs(fit, times, simulations=19)
        row = found["receiver positions"]
        assert row.receiver == "R2"
        assert row.estimate == pytest.approx((-off[2], 0.0), abs=6)
        assert found.suspects == (row.suspect,)
        assert " ! R2" in str(found)

    @pytest.mark.extended
    @pytest.mark.filterwarnings("ignore::maloc.errors.MalocWarning")
    def test_a_fit_of_the_joint_model(self):
        """Two wrong inputs at once, both named."""
        times, _, _ = cases.toa(pings=30, kind="random", unheard=())
        r = times.receivers
        moved = maloc.Receivers(r.receiver, r.x + 12.0 * (np.arange(len(r)) == 2), r.y)
        limits = maloc.Schedule("random", 21.0, 29.0)
        wrong = times.replace(receivers=moved, schedule=limits)
        fit = maloc.infer.laplace(maloc.models.joint, wrong, detection=None)
        found = maloc.infer.check_inputs(fit, wrong, simulations=15)
        assert found["burst limits"].suspect
        assert found["receiver positions"].suspect
        assert found["receiver positions"].receiver == "R2"

    @pytest.mark.extended
    def test_an_estimated_sound_speed_is_not_checked(self):
        times, _, _ = cases.toa(pings=16)
        fit = maloc.infer.laplace(toa_track, times, sound_speed="estimated")
        found = maloc.infer.check_inputs(fit, times, simulations=10)
        assert np.isnan(found["sound speed"].p)
        assert "estimated by the model" in found["sound speed"].finding
        assert 0 <= found["receiver positions"].p <= 1

    def test_pooling_the_same_fit_twice_doubles_what_is_known(self, point):
        once = array_checks.scored([point], jax.random.key(0), 2)
        twice = array_checks.scored([point, point], jax.random.key(0), 2)
        for one, two in zip(once, twice, strict=True):
            np.testing.assert_allclose(two.score, 2 * one.score)
            np.testing.assert_allclose(two.information, 2 * one.information)

    def test_refusals(self, toa, laplace_fit, fixes_fit):
        with pytest.raises(InputError, match="3 simulations are too few; give 10"):
            maloc.infer.check_inputs(laplace_fit, toa[0], simulations=3)
        with pytest.raises(InputError, match="a fit of fixes has no arrival times"):
            maloc.infer.check_inputs(fixes_fit, toa[0])
        times, _, _ = cases.toa(seed=1)
        other = maloc.infer.laplace(toa_track, times)
        with pytest.raises(InputError, match="not of one table of receivers"):
            maloc.infer.check_inputs(laplace_fit, toa[0], pool=[other])
        fewer, _, _ = cases.toa(n_receivers=5)
        with pytest.raises(InputError, match="5 receivers in the arrival times, 6 in the fit"):
            maloc.infer.check_inputs(laplace_fit, fewer)

    def test_rows_print_what_was_not_checked(self):
        rows = (InputCheck("sound speed", np.nan, np.nan, np.nan, "estimated"),)
        assert str(InputChecks(rows)).splitlines()[1].split() == [
            "sound",
            "speed",
            *"---",
            "estimated",
        ]
