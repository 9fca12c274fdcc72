"""A synchronisation in a page of text."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from maloc.sync._clocks import Clocks

__all__ = ["summary"]


def summary(sync: Clocks) -> str:
    """Return what was fitted, how well, by receiver, and every note."""
    r, used = sync.residuals, sync.residuals.used
    speed = (
        "given"
        if sync.sound_speed_sd == 0
        else f"estimated, standard error {sync.sound_speed_sd:.1f}"
    )
    lines = [
        repr(sync),
        f"sound speed {sync.sound_speed:.1f} m/s ({speed})",
        f"residuals: sd {1e3 * sync.residual_sd:.3f} ms, from the MAD "
        f"{1e3 * sync.residual_mad:.3f} ms; {len(r)} sync detections, {int(used.sum())} used",
    ]
    for why in sorted(set(r.why[~used])):
        lines.append(f"  {int((r.why == why).sum()):>8} {why}")
    lines.append("")
    width = max(8, *(len(n) for n in sync.receivers.names))
    lines.append(
        f"{'receiver':<{width}} {'offset s':>12} {'drift ppm':>10} {'sd ms':>7} "
        f"{'used':>7} {'not':>6} {'resid ms':>9}"
    )
    for i, name in enumerate(sync.receivers.names):
        mine = r.receiver == name
        counts = f"{int((mine & used).sum()):>7} {int((mine & ~used).sum()):>6}"
        if not sync.synced[i]:
            lines.append(f"{name:<{width}} {'not synchronised':>31} {counts}")
            continue
        drift = (sync.values[i, -1] - sync.values[i, 0]) / (sync.knots[-1] - sync.knots[0])
        sd = np.median(sync.values_sd[i])
        rest = r.residual[mine & used]
        rest_sd = f"{1e3 * rest.std():9.3f}" if len(rest) else f"{'':>9}"
        lines.append(
            f"{name:<{width}} {sync.values[i, 0]:>12.4f} {1e6 * drift:>10.2f} {1e3 * sd:>7.3f} "
            f"{counts} {rest_sd}"
        )
    if sync.position_sd.any():
        far = np.hypot(*sync.shift.T)
        d = int(far.argmax())
        lines += ["", f"places moved by at most {far[d]:.1f} m ({sync.receivers.labels[d]})"]
    return "\n".join([*lines, "", *map(str, sync.notes)])
