"""The paper's simulator against the paper's words, and the data that each model gets."""

import numpy as np
import pytest

from maloc.errors import InputError
from maloc.simulate.hostetter_royle import Design, simulate_study

MODELS = ("independent", "detection_only", "known_interval", "unknown_interval")


@pytest.fixture(scope="module")
def studies():
    return [simulate_study(np.random.default_rng([1, i])) for i in range(12)]


def tags(studies):
    return [tag for study in studies for tag in study.tags]


def test_the_papers_numbers():
    """logit^-1(.25) = .562; state space of 5 sigma_det around a unit grid of 10 x 10."""
    design = Design()
    assert round(design.p0, 3) == 0.562
    assert design.buffer == pytest.approx(5 * design.scale)
    xy = design.receivers().xy
    assert xy.shape == (100, 2)
    assert sorted(set(xy[:, 0])) == sorted(set(xy[:, 1])) == list(range(3, 13))
    assert list(design.low) == [-0.75] * 2 and list(design.high) == [15.75] * 2


def test_intervals_and_span(studies):
    for tag in tags(studies):
        assert 0 < tag.time[0] < 1 and 148 < tag.time[-1] <= 150
        assert np.diff(tag.time).min() >= 1 and np.diff(tag.time).max() <= 2
        assert tag.heard.any()
    steps = np.concatenate([np.diff(tag.time) for tag in tags(studies)])
    assert steps.mean() == pytest.approx(1.5, abs=0.01)
    assert steps.var() == pytest.approx(1 / 12, rel=0.03)


def test_brownian_steps(studies):
    scaled = [
        np.diff(t.position, axis=0) / np.sqrt(np.diff(t.time))[:, None] for t in tags(studies)
    ]
    assert np.concatenate(scaled).std() == pytest.approx(0.25, rel=0.01)


def test_who_hears(studies):
    """Observed shares by distance follow the half-normal within five standard errors."""
    xy = studies[0].receivers.xy
    away = np.concatenate(
        [np.linalg.norm(t.position[:, None] - xy, axis=2).ravel() for t in tags(studies)]
    )
    heard = np.concatenate([t.heard.ravel() for t in tags(studies)])
    for lo in np.arange(0, 2.4, 0.3):
        near = (away >= lo) & (away < lo + 0.3)
        p = Design().p0 * np.exp(-(away[near] ** 2) / (2 * 0.75**2))
        se = np.sqrt((p * (1 - p)).sum()) / near.sum()
        assert abs(heard[near].mean() - p.mean()) < 5 * se


def test_inside_the_array_nine_in_ten_are_heard(studies):
    """Paper: detection inside > .90; expected receivers 2 pi scale^2 p0 at unit density."""
    inside, counts = [], []
    for tag in tags(studies):
        deep = ((tag.position > 5) & (tag.position < 10)).all(axis=1)
        inside.append(tag.was_heard[deep])
        counts.append(tag.heard[deep].sum(axis=1))
    n = np.concatenate(counts)
    assert np.concatenate(inside).mean() > 0.9 - 0.06
    assert n.mean() == pytest.approx(2 * np.pi * 0.75**2 * Design().p0, rel=0.03)


def test_tags_never_heard_are_left_out():
    study = simulate_study(np.random.default_rng(0), Design(p0=1e-9))
    assert study.tags == ()
    with pytest.raises(InputError, match="no tag was heard"):
        study.history("independent")


@pytest.mark.parametrize("model", MODELS)
def test_histories_hold_the_right_pings(studies, model):
    study = studies[0]
    history = study.history(model)
    assert history.tags == tuple(t.name for t in study.tags)
    truth = study.truth(history)
    for i, tag in enumerate(study.tags):
        rows = history.tag == i
        heard = np.flatnonzero(tag.was_heard)
        if model == "known_interval":
            keep = np.arange(max(heard[0] - 5, 0), min(heard[-1] + 6, len(tag.time)))
        else:
            keep = heard
        assert np.array_equal(history.time[rows], tag.time[keep])
        assert np.array_equal(history.heard[rows], tag.heard[keep])
        assert np.array_equal(truth[rows], tag.position[keep])
        unheard = len(tag.time) - len(heard)
        assert study.missed(tag.name, 0, 150) == unheard
    assert history.known == (model == "known_interval")
    if model == "unknown_interval":
        assert history.summed and history.first_at_start
        assert set(history.start) == {0.0} and set(history.end) == {150.0}
    else:
        assert not history.summed


def test_missed_counts_open_intervals(studies):
    tag = studies[0].tags[0]
    heard = np.flatnonzero(tag.was_heard)
    a, b = heard[:-1], heard[1:]
    found = [
        studies[0].missed(tag.name, tag.time[i], tag.time[j]) for i, j in zip(a, b, strict=True)
    ]
    assert np.array_equal(found, b - a - 1)


@pytest.mark.parametrize("wrong", [{"p0": 1.2}, {"lo": 3.0}, {"side": 0}, {"buffer": -1}])
def test_impossible_designs_are_refused(wrong):
    with pytest.raises(InputError):
        Design(**wrong)
