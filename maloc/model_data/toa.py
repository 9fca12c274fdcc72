"""Arrival times as the models see them: padded arrays of one shape per bucket.

Pings that nobody heard are not states of the chain (they carry no arrival time; their positions
are predicted afterwards), so row ``t`` here is the ``t``-th heard ping. Padding pings continue
the chain with nothing heard: they integrate out of every posterior exactly.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool, Float

from maloc._jax import jax
from maloc.data._links import count_intervals
from maloc.data._padding import bucket
from maloc.data._time import NS
from maloc.data.arrivals import ArrivalTimes
from maloc.model_data.arrivals import ArrivalData, Numbers
from maloc.world.depth_data import DepthData, depth_data
from maloc.world.ray import profile_ray

__all__ = ["ToaData", "as_toa_data", "bucket", "to_model_data"]

MIN_LATENESS = 0.25  # s; receivers are blanked about this long after a detection
SPEED_SD = 0.01  # relative; a guessed sound speed is within 2 % of the truth
_STATIC = ["schedule", "speed_known"]
_MIN_STEP = 1e-3  # s; two pings at one instant still need a step


@dataclasses.dataclass(frozen=True)
class ToaData(ArrivalData):
    """One tag's heard pings, ready for a model: a pytree, the last two fields static.

    Attributes
    ----------
    range, heard, speed, ... :
        See `ArrivalData`.
    clock_sd : (T, R) m or None
        Sound speed x the standard error of the receiver's clock; None: clocks are exact.
    time : (T,) s
        First arrival of each ping, from the data set's origin.
    dt : (T - 1,) s
        Element t: from ping t to ping t + 1.
    receiver_sd : (R,) m or None
        Standard deviation of receivers' x and of y; None: nothing is known of their errors.
    depth : DepthData or None
        Depths of the tag, the receivers and the bottom; None: the track is flat.
    valid : (T,) bool
        False for padding.
    present : (R,) bool
        False for receivers that pad the shape.
    schedule : str
        "unknown", "random" or "stable".
    speed_known : bool
        False where the sound speed has an error that all pings share.
    """

    time: Float[Numbers, " ping"]
    dt: Float[Numbers, " step"]
    valid: Bool[Numbers, " ping"]
    present: Bool[Numbers, " receiver"]
    clock_sd: Float[Numbers, "ping receiver"] | None = None
    receiver_sd: Float[Numbers, " receiver"] | None = None
    depth: DepthData | None = None
    schedule: str = "unknown"
    speed_known: bool = True


jax.tree_util.register_dataclass(
    ToaData,
    data_fields=[f.name for f in dataclasses.fields(ToaData) if f.name not in _STATIC],
    meta_fields=_STATIC,
)


def to_model_data(toa: ArrivalTimes, pad: bool = True) -> ToaData:
    """Arrays of the heard pings of `toa`, padded to a bucket unless ``pad`` is false.

    Parameters
    ----------
    toa : ArrivalTimes
        P pings, R receivers.
    pad : bool
        Pad pings and receivers, so that one compilation serves many data sets.

    Returns
    -------
    ToaData
    """
    heard_rows = toa.heard.any(axis=1)
    arrivals = np.asarray(toa.toa)[heard_rows]
    heard = np.isfinite(arrivals)
    speed = np.asarray(toa.sound_speed, float)[heard_rows]
    first = np.where(heard, arrivals, np.inf).min(axis=1)
    ranges = np.where(heard, (arrivals - first[:, None]) * speed[:, None], 0.0)
    xy = np.column_stack([toa.receivers.x, toa.receivers.y]).astype(float)
    used = xy[heard.any(axis=0)]
    centre = used.mean(axis=0)
    diameter = float(np.max(np.linalg.norm(used[:, None] - used[None], axis=-1)))
    schedule = toa.schedule
    slack = 0.2 * diameter / float(speed.mean()) + 0.05
    n_intervals = count_intervals(first, schedule.kind, schedule.lo, schedule.hi, slack)

    sd = toa.sound_speed_sd
    n_pings, n_receivers = ranges.shape
    pings = bucket(n_pings) if pad else n_pings
    columns = -(-n_receivers // 4) * 4 if pad else n_receivers
    more, wider = pings - n_pings, columns - n_receivers
    steps = np.maximum(np.diff(first), _MIN_STEP)
    step = float(np.median(steps)) if n_pings > 1 else 60.0
    padding, clock = ((0, more), (0, wider)), toa.clock_sd
    padded_speed = np.append(speed, np.full(more, speed[-1]))
    data = ToaData(
        range=np.asarray(np.pad(ranges, padding)),
        heard=np.asarray(np.pad(heard, padding)),
        time=np.asarray(np.append(first, first[-1] + step * np.arange(1, more + 1))),
        dt=np.asarray(np.append(steps, np.full(more, step))),
        speed=np.asarray(padded_speed),
        speed_sd=np.asarray(SPEED_SD if sd is None else sd / float(speed.mean())),
        receiver_xy=np.asarray(np.concatenate([xy, np.repeat(centre[None], wider, axis=0)])),
        centre=np.asarray(centre),
        spread=np.asarray(max(1000.0, 2 * diameter)),
        phi=np.asarray(max(diameter, MIN_LATENESS * float(speed.mean()))),
        n_intervals=np.asarray(np.append(n_intervals, np.zeros(more))),
        interval=np.asarray([schedule.lo, schedule.hi], float),
        valid=np.asarray(np.arange(pings) < n_pings),
        present=np.asarray(np.arange(columns) < n_receivers),
        clock_sd=None if clock is None else np.pad(clock[heard_rows] * speed[:, None], padding),
        receiver_sd=_place_errors(toa.receivers, wider),
        depth=depth_data(
            toa.column,
            toa.receivers,
            None if toa.depth is None else toa.depth[heard_rows],
            first,
            more=more,
            wider=wider,
            ray=profile_ray(toa.profile, first + (toa.origin or 0) / NS, padded_speed),
        ),
        schedule=schedule.kind,
        speed_known=sd is None,
    )
    return jax.device_put(data)  # at once: one by one, each would compile a copy


def _place_errors(receivers, wider: int) -> np.ndarray | None:
    """Stated errors (m) of receivers' places, 0 of what pads them; None where none is above 0."""
    sd = receivers.position_sd
    return np.pad(sd, (0, wider)) if sd is not None and np.any(sd) else None


def as_toa_data(toa: ArrivalTimes | ToaData) -> ToaData:
    """Model arrays of `toa`: as they are, or made without padding from arrival times."""
    return toa if isinstance(toa, ToaData) else to_model_data(toa, pad=False)
