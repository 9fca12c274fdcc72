"""Starts from single pings: near the truth, straight between, and the same mode in the end."""

from __future__ import annotations

import numpy as np
import pytest

import maloc
from maloc.errors import InputError
from maloc.infer.point_start import checked_positions, pmc_positions
from maloc.model_data import to_model_data
from maloc.models import toa_track
from maloc.simulate import canal_toa
from tests.infer import cases


@pytest.fixture(scope="module")
def study():
    toa, truth = canal_toa(np.random.default_rng(3), p_na=0.3, p_mp=0.1)
    heard = np.asarray(toa.n_heard > 0)
    return toa, np.column_stack([truth.x, truth.y])[heard]


@pytest.mark.extended
def test_positions_are_near_the_truth_and_straight_where_few_heard(study):
    toa, truth = study
    data = to_model_data(toa)
    found = pmc_positions(data)
    assert found is not None and found.shape == (len(np.asarray(data.time)), 2)
    error = np.linalg.norm(found[: len(truth)] - truth, axis=1)
    assert np.median(error) < 6
    gap = np.array(toa.toa)
    gap[100, np.argsort(~toa.heard[100], kind="stable")[2:]] = np.nan  # two arrivals left
    less = pmc_positions(to_model_data(toa.replace(toa=gap)))
    assert less is not None
    time = np.asarray(data.time)
    share = (time[100] - time[99]) / (time[101] - time[99])
    np.testing.assert_allclose(less[100], less[99] + share * (less[101] - less[99]), atol=0.1)


def test_the_mode_is_that_of_the_annealed_start():
    toa, _, _ = cases.toa(pings=30, unheard=(), p_late=0.15)
    fits = [maloc.infer.laplace(toa_track, toa, positions=p) for p in (None, "pmc")]
    assert abs(fits[0].marginal.value - fits[1].marginal.value) < 0.05
    np.testing.assert_allclose(fits[0].moments()[0], fits[1].moments()[0], atol=0.05)


def test_too_few_arrivals_fall_back_and_other_names_are_refused(study):
    toa, _ = study
    two = np.argsort(np.argsort(~toa.heard, axis=1, kind="stable"), axis=1) < 2
    data = to_model_data(toa.replace(toa=np.where(two, toa.toa, np.nan)))
    assert checked_positions((data,), "pmc") is None
    assert checked_positions((data,), None) is None
    with pytest.raises(InputError, match="'magic' are unknown"):
        checked_positions((data,), "magic")
    with pytest.raises(InputError, match="needs a model of arrival times"):
        checked_positions((np.zeros(3),), "pmc")
