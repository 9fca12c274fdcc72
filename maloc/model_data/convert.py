"""Any of the containers as the arrays that its models take."""

from __future__ import annotations

from typing import Any

from maloc.data.arrivals import ArrivalTimes
from maloc.data.encounters import EncounterHistory
from maloc.data.joint_history import ArrivalHistory
from maloc.model_data import encounters, joint, toa

__all__ = ["CONTAINERS", "to_model_data"]

CONTAINERS = ArrivalTimes, EncounterHistory, ArrivalHistory


def to_model_data(data: Any, pad: bool = True) -> Any:
    """Return the arrays that models take, padded or not.

    Parameters
    ----------
    data : ArrivalTimes, EncounterHistory or ArrivalHistory
        Anything else is returned as it is.
    pad : bool
        Pad states, receivers and gaps, so that one compilation serves many data sets.

    Returns
    -------
    ToaData, EncounterData or JointData
        Of an encounter history whose schedule is known but not every ping (`summed`), gaps get
        nodes at which the path is needed, and `gaps` says how to sum the missed pings out.
    """
    if isinstance(data, ArrivalTimes):
        return toa.to_model_data(data, pad)
    if isinstance(data, EncounterHistory):
        return encounters.to_model_data(data, pad)
    if isinstance(data, ArrivalHistory):
        return joint.to_model_data(data, pad)
    return data
