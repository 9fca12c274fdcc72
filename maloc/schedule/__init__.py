"""When a tag speaks: laws of the burst interval, missed pings summed out."""

from typing import TYPE_CHECKING, Any

__all__ = ["intervals", "renewal", "signal"]

if TYPE_CHECKING:
    from maloc.schedule import intervals, renewal, signal
else:

    def __getattr__(name: str) -> Any:
        """Import a module when it is first asked for (PEP 562)."""
        if name not in __all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from importlib import import_module

        return import_module(f"{__name__}.{name}")
