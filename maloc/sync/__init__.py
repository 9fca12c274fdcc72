"""Clock synchronisation: raw receiver clocks to one common time, by sync tags.

`fit` makes a `ClockSync`; its ``apply`` puts detections on the common clock.
"""

from maloc.sync._fit import fit
from maloc.sync.clocks import ClockSync, SyncResiduals

__all__ = ["ClockSync", "SyncResiduals", "fit"]
