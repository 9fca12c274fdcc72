"""Sound speed: the equations' own check values, the standard of 2010, another equation."""

import numpy as np
import pytest

from maloc.errors import InputError
from maloc.world.seawater import _unesco, chen_millero, mackenzie

# salinity, temperature, then m/s at 0, 100 and 1000 m at 45 degrees of latitude: TEOS-10, as gsw
# 3.6.23 has it (sound_speed_t_exact, p_from_z)
TEOS_10 = np.array(
    [
        (0, 0, 1402.401, 1404.010, 1418.673),
        (0, 10, 1447.284, 1448.916, 1463.705),
        (0, 20, 1482.353, 1484.020, 1499.075),
        (0, 30, 1509.161, 1510.872, 1526.269),
        (2.5, 10, 1450.428, 1452.053, 1466.784),
        (2.5, 20, 1485.215, 1486.874, 1501.851),
        (10, 0, 1415.877, 1417.483, 1432.117),
        (10, 20, 1493.614, 1495.267, 1510.190),
        (20, 10, 1471.631, 1473.265, 1488.080),
        (20, 30, 1529.936, 1531.613, 1546.735),
        (35, 0, 1449.025, 1450.644, 1465.417),
        (35, 10, 1489.788, 1491.430, 1506.311),
        (35, 20, 1521.479, 1523.133, 1538.070),
        (40, 20, 1527.126, 1528.773, 1543.647),
        (40, 30, 1550.695, 1552.345, 1567.244),
    ]
)


def test_unesco_check_value():
    """Fofonoff & Millard (1983): salinity 40, 40 deg C, 10000 dbar: 1731.995 m/s."""
    assert _unesco(*np.array([40.0, 40.0, 1000.0])) == pytest.approx(1731.995, abs=1e-3)


def test_chen_millero_against_the_standard_of_2010():
    """Within the equation's own error from fresh water to the saltiest, to 100 m."""
    salt, warm = TEOS_10[:, :2].T[..., None]
    depth = np.array([[0.0, 100.0, 1000.0]])
    off = chen_millero(warm, salt, depth) - TEOS_10[:, 2:]
    assert np.abs(off[:, :2]).max() < 0.19 and np.sqrt(np.mean(off[:, :2] ** 2)) < 0.08
    assert np.abs(off[:, 2]).max() < 0.7


def test_mackenzie_leaves_what_it_was_fitted_to():
    """Which is why tables do not go by it: at salinity 2.5 and 10 deg C it is .8 m/s low."""
    assert mackenzie(10.0, 2.5) - 1450.428 == pytest.approx(-0.84, abs=0.05)
    assert abs(mackenzie(10.0, 35.0) - 1489.788) < 0.1


def test_mackenzie_check_value():
    """Mackenzie (1981): 25 deg C, salinity 35, 1000 m: 1550.744 m/s."""
    assert mackenzie(25.0, 35.0, 1000.0) == pytest.approx(1550.744, abs=1e-3)


def test_mackenzie_against_medwin():
    """Medwin (1975), a simpler equation: within 1 m/s in the shallow sea."""
    t, s, z = np.meshgrid([2.0, 10.0, 20.0, 30.0], [25.0, 35.0, 40.0], [0.0, 50.0, 100.0])
    medwin = 1449.2 + 4.6 * t - 0.055 * t**2 + 2.9e-4 * t**3 + (1.34 - 0.01 * t) * (s - 35)
    np.testing.assert_allclose(mackenzie(t, s, z), medwin + 0.016 * z, atol=1.0)


@pytest.mark.parametrize("equation", [chen_millero, mackenzie])
def test_what_is_no_water_is_refused(equation):
    with pytest.raises(InputError, match="temperature 60 is not between"):
        equation(60.0)
    assert np.isnan(equation(np.nan))
