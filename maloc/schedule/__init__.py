"""When a tag speaks: laws of the burst interval, missed pings summed out.

Comes in: a `Schedule`, gaps between heard pings, chances to be heard.
Goes out: log likelihoods, counts and times of missed pings.
Start reading: `intervals.py`, then `renewal/likelihood.py` (missed pings summed out with their
    path) or `signal.py` (without it).
The mathematics: docs/architecture.md, "Heard and not heard".
"""

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
