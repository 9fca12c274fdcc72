"""What the animal swims in: sound speed, water, depth, drift, the state space."""

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
