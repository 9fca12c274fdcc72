"""What models read: containers as padded arrays, one shape a bucket.

Comes in: containers of `maloc.data`.
Goes out: pytrees of padded arrays, what a NumPyro model is called with.
Start reading: `toa.py` for arrival times; `encounters.py`, with `states.py` and `gaps.py`, for
    who heard what; `joint.py` for both. Knows no model.
The page: docs/architecture.md, "The joint model".
"""

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
