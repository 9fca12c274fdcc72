"""What the options of sound speed say: a number or a table, and how sure it is."""

from __future__ import annotations

from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.errors import InputError

if TYPE_CHECKING:
    from maloc.data import Receivers
    from maloc.readers.medium import MediumTable

__all__ = ["NUMBER_SD", "number_sd", "speed_error", "speed_of_water", "sync_speed", "usual_speed"]

NUMBER_SD = 3.0  # m/s; of a number, or a column of them, that nobody says more of


def speed_of_water(text: str | None) -> float | Path | None:
    """What --sound-speed gives: m/s, or a table of the water's state.

    Raises
    ------
    InputError
        If it is neither.
    """
    if text is None:
        return None
    if Path(text).is_file():
        return Path(text)
    speed = _number(text)
    if not 1300.0 <= speed <= 1700.0:
        raise InputError(
            f"--sound-speed {text} is no file, and no speed of sound in water, 1300 to 1700 m/s",
            mend="give m/s or a table of the water (see --help for words), and how sure it is by "
            "--sound-speed-sd",
        )
    return speed


def speed_error(text: str | None) -> float | None:
    """What --sound-speed-sd gives, m/s: 0 for "exact", None where it is left to the source.

    Raises
    ------
    InputError
        If it is neither a number nor the word.
    """
    if text is None or text == "exact":
        return None if text is None else 0.0
    sd = _number(text)
    if not (isfinite(sd) and 0 <= sd <= 100):
        raise InputError(f"--sound-speed-sd {text} is neither m/s, 0 to 100, nor exact")
    return sd


def number_sd(sd: float | None) -> float | None:
    """Sd of a number of m/s as arrival times have it: None = exact."""
    return (NUMBER_SD if sd is None else sd) or None


def usual_speed(given: float | Path | None) -> float | None:
    """One speed, m/s, to read and group by; None where none is given."""
    if not isinstance(given, Path):
        return given
    from maloc.world.medium import speed_table

    return float(np.mean(speed_table(given)[1]))


def sync_speed(
    given: float | Path | str | None, sd: float | None, receivers: Receivers
) -> dict[str, Any]:
    """What `maloc.sync.fit` is told of the sound speed; a profile counts where receivers are.

    Parameters
    ----------
    given : float, Path, str or None
        m/s, a table, or a word of `maloc.sync.fit`.
    sd : float or None
        As of `speed_error`.
    receivers : Receivers
        Whose depths a profile is met at.
    """
    if given is None or isinstance(given, str):
        return {"sound_speed": given}
    if not isinstance(given, Path):
        return {"sound_speed": given, "sound_speed_sd": number_sd(sd) or 0.0}
    read = water_table(given)
    if not read.by_depth:
        return {"sound_speed": given}
    from maloc.world.medium import sound_profile, speed_among

    profile = sound_profile(read)
    speed = speed_among(profile, receivers.depth)
    if profile.time is None:
        return {"sound_speed": float(speed[0]), "sound_speed_sd": profile.sd if sd is None else sd}
    time = (profile.time * 1e9).astype("datetime64[ns]")
    return {"sound_speed": {"time": time, "sound_speed": speed}}


def water_table(path: Path) -> MediumTable:
    """Read the table that --sound-speed names."""
    from maloc.readers.medium import read_medium

    return read_medium(path)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")
