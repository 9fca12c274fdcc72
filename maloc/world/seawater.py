"""The speed of sound in water by its temperature, salinity and depth: two published equations."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.polynomial.polynomial import polyval

from maloc.errors import InputError

__all__ = ["CHEN_MILLERO_SD", "chen_millero", "mackenzie"]

CHEN_MILLERO_SD = 0.19  # m/s, the equation's own standard error
_RANGES = {"temperature": (-2.0, 35.0), "salinity": (0.0, 45.0), "depth": (0.0, 8000.0)}
_T68 = 1.00024  # degrees of 1968 in one of 1990
_GRAVITY = (5.92e-3 + 5.25e-3 * 0.5, 2.21e-6)  # Saunders (1981), at 45 degrees of latitude

# powers of pressure (bar), each a polynomial in temperature: of pure water, S, S^1.5 and S^2
_WATER = (
    (1402.388, 5.03711, -5.80852e-2, 3.3420e-4, -1.47800e-6, 3.1464e-9),
    (0.153563, 6.8982e-4, -8.1788e-6, 1.3621e-7, -6.1185e-10),
    (3.1260e-5, -1.7107e-6, 2.5974e-8, -2.5335e-10, 1.0405e-12),
    (-9.7729e-9, 3.8504e-10, -2.3643e-12),
)
_SALT = (
    (1.389, -1.262e-2, 7.164e-5, 2.006e-6, -3.21e-8),
    (9.4742e-5, -1.2580e-5, -6.4885e-8, 1.0507e-8, -2.0122e-10),
    (-3.9064e-7, 9.1041e-9, -1.6002e-10, 7.988e-12),
    (1.100e-10, 6.649e-12, -3.389e-13),
)
_SALT_15 = ((-1.922e-2, -4.42e-5), (7.3637e-5, 1.7945e-7))
_SALT_2 = ((1.727e-3,), (-7.9836e-6,))


def chen_millero(temperature: Any, salinity: Any = 35.0, depth: Any = 0.0) -> np.ndarray:
    """Speed of sound in fresh, brackish and sea water (the UNESCO equation).

    Parameters
    ----------
    temperature : array
        deg C (ITS-90), 0 to 40 in the original.
    salinity : array
        Practical salinity, 0 to 40 in the original.
    depth : array
        m; made a pressure by Saunders (1981) at 45 degrees of latitude.

    Returns
    -------
    array
        m/s, the broadcast shape; NaN where an input is NaN.

    Raises
    ------
    InputError
        If a value is not one of water: temperature -2 to 35, salinity 0 to 45, depth 0 to 8000.

    References
    ----------
    Chen & Millero (1977) Speed of sound in seawater at high pressures. J. Acoust. Soc. Am. 62(5):
    1129-1135, as in Fofonoff & Millard (1983) Unesco Tech. Pap. Mar. Sci. 44; Saunders (1981)
    Practical conversion of pressure to depth. J. Phys. Oceanogr. 11: 573-574.
    """
    t, s, z = _water(temperature, salinity, depth)
    linear, square = 1 - _GRAVITY[0], _GRAVITY[1]
    bar = 0.1 * (linear - np.sqrt(linear**2 - 4 * square * z)) / (2 * square)
    return _unesco(_T68 * t, s, bar)


def _unesco(t: np.ndarray, s: np.ndarray, bar: np.ndarray) -> np.ndarray:
    """The equation itself: temperature (IPTS-68), salinity, gauge pressure in bar."""

    def by(powers):
        return sum(polyval(t, each) * bar**i for i, each in enumerate(powers))

    return np.asarray(by(_WATER) + by(_SALT) * s + by(_SALT_15) * s**1.5 + by(_SALT_2) * s**2)


def mackenzie(temperature: Any, salinity: Any = 35.0, depth: Any = 0.0) -> np.ndarray:
    """Speed of sound in sea water by nine terms in temperature, salinity and depth.

    Parameters
    ----------
    temperature : array
        deg C, 2 to 30 in the original.
    salinity : array
        Practical salinity, 25 to 40 in the original; for less see `chen_millero`.
    depth : array
        m, 0 to 8000.

    Returns
    -------
    array
        m/s, the broadcast shape; NaN where an input is NaN.

    Raises
    ------
    InputError
        If a value is not one of water: temperature -2 to 35, salinity 0 to 45, depth 0 to 8000.

    References
    ----------
    Mackenzie (1981) Nine-term equation for sound speed in the oceans. J. Acoust. Soc. Am. 70(3):
    807-812.
    """
    t, s, d = _water(temperature, salinity, depth)
    s = s - 35.0
    return (
        1448.96 + 4.591 * t - 5.304e-2 * t**2 + 2.374e-4 * t**3 + 1.340 * s
        + 1.630e-2 * d + 1.675e-7 * d**2 - 1.025e-2 * t * s - 7.139e-13 * t * d**3
    )  # fmt: skip


def _water(temperature: Any, salinity: Any, depth: Any) -> tuple[np.ndarray, ...]:
    """Temperature, salinity and depth as arrays, if they are those of water."""
    given = {"temperature": temperature, "salinity": salinity, "depth": depth}
    for name, value in given.items():
        low, high = _RANGES[name]
        wrong = np.asarray(value, float)
        wrong = wrong[(wrong < low) | (wrong > high)]
        if wrong.size:
            raise InputError(f"{name} {wrong.flat[0]:g} is not between {low:g} and {high:g}")
    return tuple(np.asarray(v, float) for v in given.values())
