"""What models read: containers as padded arrays, one shape a bucket."""

from maloc.model_data.convert import to_model_data
from maloc.model_data.encounters import EncounterData, as_encounter_data
from maloc.model_data.joint import JointData, as_joint_data
from maloc.model_data.prune import prune_bound
from maloc.model_data.toa import ToaData, as_toa_data

__all__ = [
    "EncounterData",
    "JointData",
    "ToaData",
    "as_encounter_data",
    "as_joint_data",
    "as_toa_data",
    "prune_bound",
    "to_model_data",
]
