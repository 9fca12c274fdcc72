"""Clock synchronisation: raw receiver clocks to one common time, by sync tags.

`fit` makes a `ClockSync`; its ``apply`` puts detections on the common clock. `rough` does with the
animals' own tags, to about a second.
"""

from maloc.sync._fit import fit
from maloc.sync._rough import rough
from maloc.sync.clocks import ClockJumps, ClockSync, SyncResiduals

__all__ = ["ClockJumps", "ClockSync", "SyncResiduals", "fit", "rough"]
