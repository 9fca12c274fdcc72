"""Names that have moved: each old one works for one more release, and says once where it went.

`MODULES` are modules that are imported under an old name, `NAMES` what a package handed on, and
`call` serves methods whose work is done in another room now. Nothing else may import by text.
"""

from __future__ import annotations

import sys
import warnings
from importlib import import_module
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

__all__ = ["MODULES", "NAMES", "call", "install", "name_of"]

MODULES = {
    "maloc.data.check": "maloc.readers.check",
    "maloc.data.clock_pings": "maloc.model_data.clock_pings",
    "maloc.data.depth_data": "maloc.world.depth_data",
    "maloc.data.encounter_data": "maloc.model_data.encounters",
    "maloc.data.joint_data": "maloc.model_data.joint",
    "maloc.data.model_data": "maloc.model_data.toa",
    "maloc.data.polygons": "maloc.readers.polygons",
    "maloc.data.raster": "maloc.readers.raster",
    "maloc.data.readers": "maloc.readers",
    "maloc.depth": "maloc.world.depth",
    "maloc.drift": "maloc.world.drift",
    "maloc.habitat": "maloc.world.habitat",
    "maloc.intervals": "maloc.schedule.intervals",
    "maloc.medium": "maloc.world.medium",
    "maloc.rangetest": "maloc.detection.rangetest",
    "maloc.renewal": "maloc.schedule.renewal",
    "maloc.signal": "maloc.schedule.signal",
    "maloc.statespace": "maloc.world.statespace",
}
NAMES = {
    "maloc.data.CheckReport": "maloc.readers.check",
    "maloc.data.read_detections": "maloc.readers",
    "maloc.data.read_events": "maloc.readers",
    "maloc.data.read_positions": "maloc.readers",
    "maloc.data.read_receivers": "maloc.readers",
    "maloc.data.read_tags": "maloc.readers",
    "maloc.data.read_toa": "maloc.readers",
}


def name_of(package: str, name: str) -> Any:
    """Return what a package handed on under a name that has moved.

    Raises
    ------
    AttributeError
        If no such name has moved.
    """
    home = NAMES.get(f"{package}.{name}")
    if home is None:
        raise AttributeError(f"module {package!r} has no attribute {name!r}")
    _warn(f"{package}.{name}", f"{home}.{name}", 4)
    return getattr(import_module(home), name)


def call(old: str, home: str, name: str, *args: Any, **options: Any) -> Any:
    """Call what a method does now, for a method that goes with the next release."""
    _warn(old, f"{home}.{name}", 4)
    return getattr(import_module(home), name)(*args, **options)


def _warn(old: str, new: str, level: int) -> None:
    text = f"{old} is {new} now; the old name goes with the next release"
    warnings.warn(text, DeprecationWarning, stacklevel=level)


class _Finder:
    """Finds a module that has moved, and hands over the one at the new place."""

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> ModuleSpec | None:
        for old, new in MODULES.items() if fullname.startswith("maloc.") else ():
            if fullname == old or fullname.startswith(f"{old}."):
                from importlib.util import find_spec

                place = new + fullname.removeprefix(old)
                loader: Any = self
                return ModuleSpec(fullname, loader, origin=place) if find_spec(place) else None
        return None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        assert spec.origin is not None
        _warn(spec.name, spec.origin, 3)
        module = import_module(spec.origin)
        spec.loader_state = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        # the import system has written the old name's spec into it: the module keeps its own
        assert module.__spec__ is not None
        module.__spec__ = module.__spec__.loader_state


def install() -> None:
    """Let old names be found, first of all: a moved package would find its modules twice."""
    if not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Finder())
