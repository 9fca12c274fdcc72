import numpy as np
from scipy.interpolate import CubicHermiteSpline

from maloc.sync._curve import evaluate, to_common

FIRST, SPACING = 100.0, 1800.0
RNG = np.random.default_rng(4)
STATE = np.stack(
    [RNG.normal(0, 50, (5, 3)), RNG.normal(0, 0.05, (5, 3))], axis=-1
)  # 3 clocks, 5 knots
STATE[:, :, 0] = STATE[0, :, 0] + np.arange(5)[:, None] * STATE[0, :, 1]
KNOTS = FIRST + SPACING * np.arange(5)


def test_curve_is_scipys_hermite_spline_and_straight_outside():
    receiver = np.repeat(np.arange(3), 200)
    common = np.tile(np.linspace(FIRST - 500, KNOTS[-1] + 900, 200), 3)
    got = evaluate(STATE, FIRST, SPACING, receiver, common)
    for r in range(3):
        spline = CubicHermiteSpline(KNOTS, STATE[:, r, 0], STATE[:, r, 1] / SPACING)
        t = common[receiver == r]
        inside = np.clip(t, KNOTS[0], KNOTS[-1])
        expected = spline(inside) + (t - inside) * spline(inside, 1)
        np.testing.assert_allclose(got[receiver == r], expected, atol=1e-11)


def test_to_common_undoes_the_offset():
    rng = np.random.default_rng(1)
    receiver = rng.integers(0, 3, 500)
    common = rng.uniform(-1e3, 1e4, 500)
    recorded = common + evaluate(STATE, FIRST, SPACING, receiver, common)
    for guess in (None, common + 30.0):
        back = to_common(STATE, FIRST, SPACING, receiver, recorded, guess)
        np.testing.assert_allclose(back, common, atol=1e-9)
