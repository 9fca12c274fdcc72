"""maloc: movement-assisted localization of tagged animals.

One Bayesian posterior of where a tagged animal was, from arrival times, schedules and movement.
Everything below is imported when it is first used (PEP 562), so that ``import maloc`` is instant.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from maloc import (
        arrival,
        biology,
        classical,
        detection,
        drift,
        emitters,
        errors,
        evaluate,
        export,
        habitat,
        infer,
        intervals,
        medium,
        models,
        movement,
        plots,
        points,
        predict,
        rangetest,
        renewal,
        signal,
        simulate,
        statespace,
        sync,
        tags,
    )
    from maloc.data import (
        ArrivalHistory,
        ArrivalTimes,
        Detections,
        EncounterHistory,
        Receivers,
        Schedule,
        WaterColumn,
        arrival_history,
        encounter_history,
        read_detections,
        read_events,
        read_positions,
        read_receivers,
        read_tags,
        read_toa,
        toa_matrix,
    )
    from maloc.data.check import check

__version__ = "0.2.0"

__all__ = [
    "ArrivalHistory",
    "ArrivalTimes",
    "Detections",
    "EncounterHistory",
    "Receivers",
    "Schedule",
    "WaterColumn",
    "arrival",
    "arrival_history",
    "biology",
    "classical",
    "check",
    "detection",
    "drift",
    "emitters",
    "encounter_history",
    "errors",
    "evaluate",
    "export",
    "habitat",
    "infer",
    "intervals",
    "medium",
    "models",
    "movement",
    "plots",
    "points",
    "predict",
    "rangetest",
    "read_detections",
    "read_events",
    "read_positions",
    "read_receivers",
    "read_tags",
    "read_toa",
    "renewal",
    "signal",
    "simulate",
    "statespace",
    "sync",
    "tags",
    "toa_matrix",
]

if not TYPE_CHECKING:
    _SUBMODULES = frozenset(
        [
            "arrival",
            "biology",
            "classical",
            "detection",
            "drift",
            "emitters",
            "errors",
            "evaluate",
            "export",
            "habitat",
            "infer",
            "intervals",
            "medium",
            "models",
            "movement",
            "plots",
            "points",
            "predict",
            "rangetest",
            "renewal",
            "signal",
            "simulate",
            "statespace",
            "sync",
            "tags",
        ]
    )

    def __getattr__(name: str):
        """Import a submodule, or a name of ``maloc.data``, on first use."""
        if name not in __all__:
            raise AttributeError(f"module 'maloc' has no attribute {name!r}")
        from importlib import import_module

        if name in _SUBMODULES:
            return import_module(f"maloc.{name}")
        home = "maloc.data.check" if name == "check" else "maloc.data"
        value = getattr(import_module(home), name)
        globals()[name] = value
        return value

    def __dir__() -> list[str]:
        return sorted([*globals(), *__all__])
