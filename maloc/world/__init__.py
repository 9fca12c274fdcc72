"""What the animal swims in: sound speed, water, depth, drift, the state space.

Comes in: coast lines, bathymetry, the water's state, positions.
Goes out: densities, distances with gradients, speeds; `depth_data.py` is the depths of a data set
    as models see them.
Start reading: `habitat.py`, `depth.py`, `medium.py`. Knows no model.
The mathematics: docs/architecture.md, "Water" and "Depth".
"""

from typing import TYPE_CHECKING, Any

__all__ = ["depth", "drift", "habitat", "medium", "statespace"]

if TYPE_CHECKING:
    from maloc.world import depth, drift, habitat, medium, statespace
else:

    def __getattr__(name: str) -> Any:
        """Import a module when it is first asked for (PEP 562)."""
        if name not in __all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from importlib import import_module

        return import_module(f"{__name__}.{name}")
