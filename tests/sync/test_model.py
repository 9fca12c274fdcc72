import numpy as np
import pytest

from maloc.sync import _model
from maloc.sync._arrivals import Arrivals, distances, links, p_direct, travel_derivative
from maloc.sync._arrivals import Geometry as Places
from maloc.sync._curve import evaluate
from tests import oracles

PLACES = np.array([[0.0, 0, 0], [210, 15, 0], [180, 220, 0], [-30, 190, 0]])
FIRST, SPACING, KNOTS = -1.0, 1800.0, 4
GRID = _model.Grid(FIRST, SPACING, KNOTS)
NONE = _model.Jumps(np.zeros(0, int), np.zeros(0, int), np.zeros(0))


def Geometry(xyz, sd, speed, speed_sd):  # noqa: N802
    return Places(xyz, np.full(len(xyz), sd), speed, speed_sd)


def solve(a, geometry, state, *, jumps=NONE, **how):
    return _model.solve(a, geometry, _model.Start(state, jumps), GRID, 0, **how)


def world(seed=0, n_pings=60, sigma=3e-4, late=0.0, places=PLACES, speed=1490.0):
    """Pings of 4 tags heard by the other 3 receivers; clocks bend between their knots."""
    rng = np.random.default_rng(seed)
    n = len(places)
    state = np.zeros((KNOTS, n, 2))
    state[:, 1:, 0] = rng.normal(0, 1, (1, n - 1)) + rng.normal(0, 5e-3, (KNOTS, n - 1))
    state[:, 1:, 1] = rng.normal(0, 5e-3, (KNOTS, n - 1))
    emission = np.sort(rng.uniform(0, SPACING * (KNOTS - 1) - 2, n_pings))
    tag = rng.integers(0, n, n_pings)
    ping, receiver = np.divmod(np.arange(n * n_pings), n)
    keep = (receiver != tag[ping]) & (rng.random(len(ping)) > 0.1)
    ping, receiver = ping[keep], receiver[keep]
    few = np.bincount(ping, minlength=n_pings)[ping] < 2
    ping, receiver = ping[~few], receiver[~few]
    source = tag[ping]
    true = emission[ping] + distances(places, receiver, source) / speed
    reflected = rng.random(len(ping)) < late
    true = true + np.where(reflected, rng.uniform(0.01, 0.2, len(ping)), 0.0)
    recorded = true + evaluate(state, FIRST, SPACING, receiver, true)
    recorded = recorded + sigma * rng.standard_normal(len(ping))
    ping = np.unique(ping, return_inverse=True)[1]
    start = state.copy()
    start[:, 1:, 0] += rng.normal(0, 5e-3, (KNOTS, n - 1))
    segment = np.zeros(len(ping), int)
    return Arrivals(recorded, receiver, ping, receiver, source, segment), state, start, reflected


def test_equals_dense_least_squares_with_emission_times_kept():
    a, _, start, _ = world()
    geometry = Geometry(PLACES, 0.0, 1500.0, 50.0)
    fit = solve(
        a, geometry, start, robust=False, sigma=3e-4, intensity=1e-14
    )  # fmt: skip
    state, sd, speed = oracles.clocks_dense(
        a.recorded,
        a.receiver,
        a.ping,
        distances(PLACES, a.place, a.source),
        start,
        FIRST + SPACING * np.arange(KNOTS),
        0,
        3e-4,
        1e-14,
        (1500.0, 50.0),
    )
    np.testing.assert_allclose(fit.end.state, state, atol=2e-7)
    np.testing.assert_allclose(fit.state_sd, sd, rtol=2e-3)
    assert fit.speed[0] == pytest.approx(speed, abs=1e-3)


def test_late_arrivals_change_nothing():
    a, state, start, reflected = world(seed=3, n_pings=300, late=0.15)
    geometry = Geometry(PLACES, 0.0, 1500.0, 50.0)
    fit = solve(a, geometry, start)
    kept = ~reflected
    kept &= np.bincount(a.ping, kept)[a.ping] >= 2
    clean = Arrivals(*(v[kept] for v in a))
    clean = clean._replace(ping=np.unique(clean.ping, return_inverse=True)[1])
    known = solve(clean, geometry, start)
    assert fit.converged
    assert known.converged
    assert np.abs(fit.end.state[..., 0] - known.end.state[..., 0]).max() < 1e-4
    assert fit.sigma == pytest.approx(3e-4, rel=0.15)
    assert fit.reflected == pytest.approx(0.15, abs=0.06)
    assert abs(fit.speed[0] - 1490.0) < 3 * fit.speed_sd.mean()
    lost = reflected & (fit.p_direct > 0.5) & (np.abs(fit.residual) > 2e-3)
    assert not lost.any()
    # and a fit that believes them is far off: the test can fail
    fooled = solve(a, geometry, start, robust=False)
    wrong = np.abs(fooled.end.state[..., 0] - state[..., 0]).max()
    assert wrong > 10 * np.abs(fit.end.state[..., 0] - state[..., 0]).max()


def test_places_are_found_within_their_prior():
    rng = np.random.default_rng(5)
    places = np.vstack([PLACES, [[90.0, 100, 0], [300, 120, 0]]])
    moved = places.copy()
    moved[:, :2] += rng.normal(0, 1.0, (6, 2))
    a, _, start, _ = world(seed=6, n_pings=400, places=moved)
    held = solve(a, Geometry(places, 0.0, 1490.0, 0.0), start)
    free = solve(a, Geometry(places, 1.0, 1490.0, 0.0), start)
    assert free.sigma == pytest.approx(3e-4, rel=0.1)
    assert held.sigma > 1.5 * free.sigma

    # distances, which the pings tell in part, come near; shift and rotation stay with the table
    i, j = np.triu_indices(6, 1)
    before = distances(places, i, j) - distances(moved, i, j)
    after = distances(free.xyz, i, j) - distances(moved, i, j)
    assert np.abs(after).mean() < 0.5 * np.abs(before).mean()
    assert np.abs((free.xyz - places)[:, :2].mean(0)).max() < 0.05


def test_given_sound_speed_is_kept_to_the_digit():
    a, _, start, _ = world(n_pings=200)
    fit = solve(a, Geometry(PLACES, 0.0, 1475.0, 0.0), start)
    assert fit.speed[0] == 1475.0
    assert fit.speed_sd.mean() == 0.0


def test_derivative_of_the_travel_time_by_differences():
    a, *_ = world(n_pings=20)
    slowness, at = 1 / 1480.0, links(world(n_pings=20)[0])
    assert len(at.place) == len(set(zip(a.place, a.source, strict=True)))
    got = travel_derivative(at, PLACES, slowness)[at.of]
    for place in range(4):
        for axis in range(2):
            shifted = [PLACES.copy(), PLACES.copy()]
            for sign, xyz in zip((-1e-4, 1e-4), shifted, strict=True):
                xyz[place, axis] += sign
            low, high = (distances(xyz, a.place, a.source) for xyz in shifted)
            expected = slowness * (high - low) / 2e-4
            np.testing.assert_allclose(got[:, 2 * place + axis], expected, atol=1e-11)


def test_p_direct_redescends_and_is_harder_on_early_arrivals():
    r = np.array([0.0, 3e-4, 3e-3, 0.05, 0.25, -3e-3, -0.2, 1.0])
    p = p_direct(r, 3e-4, 0.15)
    assert p[0] > 0.99
    assert p[1] > 0.98
    assert (p[2:] < 1e-6).all()
    borderline = p_direct(np.array([1.05e-3, -1.05e-3]), 3e-4, 0.15)
    assert borderline[0] < borderline[1]  # late is likelier than early, so it is doubted sooner
