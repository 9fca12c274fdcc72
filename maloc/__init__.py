"""maloc: movement-assisted localization of tagged animals.

One Bayesian posterior of where a tagged animal was, from arrival times, schedules and movement.
Everything below is imported when it is first used (PEP 562), so that ``import maloc`` is instant.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from maloc._package.version import __version__ as __version__

if TYPE_CHECKING:
    from maloc import (
        arrival,
        biology,
        classical,
        detection,
        emitters,
        errors,
        evaluate,
        export,
        infer,
        models,
        movement,
        plots,
        points,
        predict,
        simulate,
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
        toa_matrix,
    )
    from maloc.detection import rangetest
    from maloc.readers import (
        read_detections,
        read_events,
        read_positions,
        read_receivers,
        read_tags,
        read_toa,
    )
    from maloc.readers.check import check
    from maloc.schedule import intervals, renewal, signal
    from maloc.world import drift, habitat, medium, statespace

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
    from maloc._package import moved

    moved.install()
    _SUBMODULES = frozenset(
        [
            "arrival",
            "biology",
            "classical",
            "detection",
            "emitters",
            "errors",
            "evaluate",
            "export",
            "infer",
            "models",
            "movement",
            "plots",
            "points",
            "predict",
            "simulate",
            "sync",
            "tags",
        ]
    )
    # where a name stands that is no module or package of the root itself
    _HOMES = {
        "drift": "maloc.world",
        "habitat": "maloc.world",
        "intervals": "maloc.schedule",
        "medium": "maloc.world",
        "rangetest": "maloc.detection",
        "renewal": "maloc.schedule",
        "signal": "maloc.schedule",
        "statespace": "maloc.world",
    }

    def __getattr__(name: str):
        """Import a module, or a name that another package offers, on first use."""
        if name not in __all__:
            raise AttributeError(f"module 'maloc' has no attribute {name!r}")
        from importlib import import_module

        if name in _HOMES:
            return import_module(f"{_HOMES[name]}.{name}")
        if name in _SUBMODULES:
            return import_module(f"maloc.{name}")
        home = "maloc.readers" if name.startswith("read_") else "maloc.data"
        home = "maloc.readers.check" if name == "check" else home
        value = getattr(import_module(home), name)
        globals()[name] = value
        return value

    def __dir__() -> list[str]:
        return sorted([*globals(), *__all__])
