"""Range tests: simulated moorings give back the curve, with intervals that cover it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import stats
from scipy.special import expit

from maloc.detection import CAP
from maloc.detection.rangetest import range_test
from maloc.errors import InputError
from maloc.plots._rangetest import detection_curve

P0, SCALE = 0.8, 180.0


def moorings(rng, n=400, *, kind="halfnormal", lost=0.0, coefficient=0.0):
    """Pings of 8 tags amid 10 receivers, some of them off: heard, positions, receivers, ..."""
    receiver_xy = rng.uniform(0, 900, (10, 2))
    positions = rng.uniform(0, 900, (8, 2))[rng.integers(0, 8, n)]
    covariates = rng.normal(size=(n, 10, 1))
    listening = rng.uniform(size=(n, 10)) < 0.9
    d = np.linalg.norm(positions[:, None] - receiver_xy[None], axis=2)
    top = expit(np.log(P0 / (1 - P0)) + coefficient * covariates[..., 0])
    if kind == "halfnormal":
        p = top * np.exp(-(d**2) / (2 * SCALE**2))
    elif kind == "logistic":
        p = expit(np.log(P0 / (1 - P0)) + 3 - np.sqrt(d**2 + (0.1 * SCALE) ** 2) / SCALE)
    else:
        p = top * (1 - np.exp(-((d**2 / SCALE**2 + 0.01) ** -1.5)))
    heard = (rng.uniform(size=d.shape) < p) & listening
    heard &= rng.uniform(size=(n, 1)) >= lost
    return heard, positions, receiver_xy, listening, covariates


def test_intervals_cover_the_truth():
    """90 % intervals of 40 fits: both too few and too many hits are unlikely."""
    hits = {"p0": 0, "scale": 0, "reach": 0}
    truth = {"p0": P0, "scale": SCALE, "reach": SCALE * np.sqrt(2 * np.log(CAP * P0 / 0.5))}
    for seed in range(40):
        heard, positions, xy, listening, _ = moorings(np.random.default_rng(seed))
        fit = range_test(heard, positions, xy, listening=listening, draws=500)
        found = fit.estimates(level=0.9) | {"reach": fit.reach(0.5, level=0.9)}
        for name, value in truth.items():
            hits[name] += found[name][1] <= value <= found[name][2]
    for n in hits.values():
        assert stats.binomtest(n, 40, 0.9).pvalue > 1e-3


@pytest.mark.parametrize("kind", ["halfnormal", "logistic", "hazard"])
def test_everything_at_once(kind):
    rng = np.random.default_rng(3)
    heard, positions, xy, listening, covariates = moorings(rng, 6000, kind=kind, lost=0.2)
    fit = range_test(heard, positions, xy, listening=listening, kind=kind, loss=True)
    _, low, high = fit.estimates(level=0.999)["p_lost"]
    assert low < 0.2 < high and high - low < 0.1
    _, low, high = fit.estimates(level=0.999)["scale"]
    assert low < SCALE < high
    assert fit.unheard == pytest.approx(1 - np.mean(heard.any(axis=1)), abs=0.02)
    assert "p_lost" in repr(fit)


def test_only_heard_pings():
    """Dividing by the chance of being heard gives the same curve as knowing all pings."""
    rng = np.random.default_rng(5)
    heard, positions, xy, listening, _ = moorings(rng, 4000)
    some = heard.any(axis=1)
    assert some.mean() < 0.9
    whole = range_test(heard, positions, xy, listening=listening)
    only = range_test(heard[some], positions[some], xy, listening=listening[some], conditional=True)
    for name, truth in (("p0", P0), ("scale", SCALE)):
        _, low, high = only.estimates(level=0.999)[name]
        assert low < truth < high
        sd = np.std(whole.draws[name])
        assert abs(np.mean(only.draws[name]) - np.mean(whole.draws[name])) < 3 * sd
    assert only.unheard == pytest.approx(1 - some.mean(), abs=0.03)
    naive = range_test(heard[some], positions[some], xy, listening=listening[some])
    assert naive.estimates(level=0.999)["p0"][1] > P0
    # observed shares, each receiver asked about what others heard, lie around the curve
    bins = only.bins(np.linspace(0, 600, 7))
    inside = (bins.low < only.curve(bins.distance)[0]) & (only.curve(bins.distance)[0] < bins.high)
    assert inside.sum() >= len(inside) - 1


@pytest.mark.extended
def test_covariates_and_nuts_agrees_with_laplace():
    rng = np.random.default_rng(8)
    heard, positions, xy, listening, covariates = moorings(rng, 800, coefficient=0.7)
    options = {"listening": listening, "covariates": covariates, "draws": 1000}
    laplace = range_test(heard, positions, xy, **options)
    nuts = range_test(heard, positions, xy, method="nuts", **options)
    _, low, high = laplace.estimates(level=0.999)["coefficient"]
    assert low[0] < 0.7 < high[0]
    for name, draws in laplace.draws.items():
        sd = np.std(draws)
        assert abs(np.mean(draws) - np.mean(nuts.draws[name])) < 0.25 * sd
        assert np.std(nuts.draws[name]) == pytest.approx(sd, rel=0.2)


def test_reach_inverts_the_curve():
    heard, positions, xy, listening, _ = moorings(np.random.default_rng(1))
    fit = range_test(heard, positions, xy, listening=listening, kind="hazard")
    for p in (0.5, 0.05):
        d, low, high = fit.reach(p)
        assert 0 < low < d < high
        # monotone in every draw, so that the medians match
        assert fit.curve([d])[0][0] == pytest.approx(p, rel=2e-3)
    assert fit.reach(0.999)[0] == 0
    with pytest.raises(InputError, match="between 0 and 1"):
        fit.reach(1.0)


def test_wilson_intervals_are_scipys():
    heard, positions, xy, listening, _ = moorings(np.random.default_rng(1))
    bins = range_test(heard, positions, xy, listening=listening).bins()
    assert bins.pings.sum() == listening.sum()
    for share, n, low, high in zip(bins.share, bins.pings, bins.low, bins.high, strict=True):
        want = stats.binomtest(round(share * n), int(n)).proportion_ci(method="wilson")
        assert (low, high) == pytest.approx((want.low, want.high), abs=1e-6)


def test_figure():
    from matplotlib import pyplot as plt

    heard, positions, xy, listening, _ = moorings(np.random.default_rng(1))
    ax = detection_curve(range_test(heard, positions, xy, listening=listening))
    assert "distance" in ax.get_xlabel() and ax.get_legend() is not None
    plt.close("all")


def test_refusals():
    heard, positions, xy, listening, _ = moorings(np.random.default_rng(1), 50)
    for message, change in (
        ("not of shape", {"heard": heard[0]}),
        ("positions has shape", {"positions": positions[:3]}),
        ("receivers' positions", {"receiver_xy": None}),
        ("listening has shape", {"listening": listening[:, :2]}),
        ("finite", {"positions": positions * np.nan}),
        ("did not listen", {"listening": np.zeros_like(listening)}),
        ("was heard", {"heard": np.zeros_like(heard)}),
        ("cannot be told", {"loss": True, "conditional": True}),
        ("none of laplace", {"method": "guess"}),
    ):
        given: dict[str, Any] = {"heard": heard, "positions": positions, "receiver_xy": xy} | change
        with pytest.raises(InputError, match=message):
            range_test(**given)
