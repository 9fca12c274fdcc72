"""Everything the array tells, as the joint model sees it: one chain of states of all tags.

States are those of `maloc.model_data.encounters`: heard pings, unheard pings of a known schedule,
and nodes inside gaps in which pings may have been missed. Only heard pings have arrival times.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float

from maloc._jax import jax
from maloc.data._time import NS
from maloc.data.joint_history import ArrivalHistory, as_history
from maloc.model_data.arrivals import ArrivalData, Numbers
from maloc.model_data.encounters import EncounterData
from maloc.model_data.encounters import to_model_data as who_heard
from maloc.model_data.states import chain
from maloc.model_data.toa import MIN_LATENESS, SPEED_SD
from maloc.world.depth_data import DepthData, depth_data
from maloc.world.ray import profile_ray

__all__ = ["JointData", "as_joint_data", "to_model_data"]

_STATIC = ["schedule", "silence", "speed_known"]


@dataclasses.dataclass(frozen=True)
class JointData(ArrivalData):
    """S states of all tags, R receivers: a pytree, the last three fields static.

    Attributes
    ----------
    range, heard, speed, ... :
        See `ArrivalData`.
    encounters : EncounterData
        The same states, who listened and who heard; `time`, `dt`, `tag`, `valid` are read there.
    clock_sd : (S, R) m
        Sound speed x the sd of the receiver's clock then.
    nominal : (S - 1,) s
        Their length by a stable or a known sequence of intervals.
    depth : DepthData or None
        Depths of the tags, the receivers and the bottom; None: tracks are flat.
    schedule : str
        "unknown", "random", "stable" or "sequence".
    silence : str
        What is known of pings that nobody heard. "given": each is a state; "summed": their number
        and times are summed out; "unknown": pings are known because they were heard.
    speed_known : bool
        False where the sound speed has an error that all pings share.
    """

    encounters: EncounterData
    clock_sd: Float[Numbers, "state receiver"]
    nominal: Float[Numbers, " step"]
    depth: DepthData | None = None
    schedule: str = "unknown"
    silence: str = "unknown"
    speed_known: bool = True

    @property
    def time(self):
        """First arrival, or nominal time, of each state (S,), s."""
        return self.encounters.time

    @property
    def dt(self):
        """Seconds from each state to the next (S - 1,)."""
        return self.encounters.dt

    @property
    def tag(self):
        """Index of the tag (S,)."""
        return self.encounters.tag

    @property
    def valid(self):
        """False for padding (S,)."""
        return self.encounters.valid

    @property
    def ping(self):
        """Whether a ping is known to have been sent here (S,)."""
        return self.encounters.ping

    @property
    def present(self):
        """False for receivers that pad the shape (R,)."""
        return self.encounters.present

    @property
    def gaps(self):
        """Gaps in which missed pings are summed out, or None."""
        return self.encounters.gaps


jax.tree_util.register_dataclass(
    JointData,
    data_fields=[f.name for f in dataclasses.fields(JointData) if f.name not in _STATIC],
    meta_fields=_STATIC,
)


def to_model_data(history: ArrivalHistory, pad: bool = True) -> JointData:
    """Arrays of `history`, padded to a bucket unless ``pad`` is false.

    Parameters
    ----------
    history : ArrivalHistory
        P pings of N tags, R deployments.
    pad : bool
        Pad states, receivers and gaps, so that one compilation serves many data sets.
    """
    who = history.encounters
    states = chain(who)
    encounters = who_heard(who, pad)
    s, r = len(states.time), len(who.receivers)
    more, wider = len(encounters.valid) - s, len(encounters.present) - r
    ping = states.row >= 0
    row = np.where(ping, states.row, 0)
    heard = ping[:, None] & who.heard[row]
    arrival = np.where(heard, history.arrival[row] - who.time[row][:, None], 0.0)
    speed = np.interp(np.arange(s), np.flatnonzero(ping), history.sound_speed[states.row[ping]])
    xy = np.asarray(encounters.receiver_xy)
    used = xy[:r][who.heard.any(axis=0)]
    diameter = float(np.max(np.linalg.norm(used[:, None] - used[None], axis=-1)))
    links = history.links
    linked = ping[:-1] & ping[1:] & (np.diff(states.tag) == 0)
    if history.schedule == "random":  # an unheard ping's own time says nothing
        some = np.asarray(heard.any(axis=1))
        linked &= some[:-1] & some[1:]
    step = row[:-1][linked]
    n_intervals, nominal = np.zeros(s - 1), np.zeros(s - 1)
    n_intervals[linked], nominal[linked] = links.n[step], links.nominal[step]
    if history.silence == "summed":  # more than one interval: the gap's own factor knows
        n_intervals[n_intervals > 1] = 0.0
    sensed = np.where(ping, history.sensed_depth[row], np.nan)
    column, whose = history.column, states.tag
    grid, along = ((0, more), (0, wider)), (0, more)
    reference = np.pad(speed, along, mode="edge")
    ray = profile_ray(history.profile, states.time + (who.origin or 0) / NS, reference)
    data = JointData(
        encounters=encounters,
        range=np.pad(arrival * speed[:, None], grid),
        heard=np.pad(heard, grid),
        clock_sd=np.pad(history.clock_sd[row] * speed[:, None], grid),
        speed=reference,
        speed_sd=np.asarray(history.speed_sd or SPEED_SD),
        receiver_xy=xy,
        centre=used.mean(axis=0),
        spread=np.asarray(max(1000.0, 2 * diameter)),
        phi=np.asarray(max(diameter, MIN_LATENESS * float(speed.mean()))),
        n_intervals=np.pad(n_intervals, along),
        nominal=np.pad(nominal, along),
        interval=np.asarray(history.interval, float),
        depth=depth_data(column, who.receivers, sensed, states.time, whose, more, wider, ray),
        schedule=history.schedule,
        silence=history.silence,
        speed_known=history.speed_sd is None,
    )
    return jax.device_put(data)


def as_joint_data(history) -> JointData:
    """Model arrays: as they are, or made without padding from a history or arrival times."""
    if isinstance(history, JointData):
        return history
    return to_model_data(as_history(history), pad=False)
