"""What a model's sites run along, and their units.

A model file says so in ``DIMS`` and ``UNITS``, and what the chain's time is called in ``ALONG``.
"""

from __future__ import annotations

import inspect

import numpy as np

from maloc.infer._model import ChainModel
from maloc.movement import CTCRW, OU, Brownian
from maloc.world.statespace import SoftBox

__all__ = ["along", "cut", "dims_of", "units_of"]

_UNITS = {"position": "m", "emission": "m", "emission_time": "s", "depth": "m"}


def along(cm: ChainModel) -> str:
    """Dimension of the chain's time: "ping" unless the model file has a name of its own."""
    return _declared(cm, "ALONG") or "ping"


def dims_of(cm: ChainModel, name: str, shape: tuple[int, ...], states: int) -> tuple[str, ...]:
    """Dimensions of a site's value, chain and draw aside.

    Parameters
    ----------
    cm : ChainModel
        The model.
    name, shape : str, tuple of int
        The site and its value's shape.
    states : int
        Length of the chain: what a site is told by that no model file declares.
    """
    for site in cm.chain:
        if site.name == name:
            return (along(cm), *_tail(site, shape[1:]))
    known = (_declared(cm, "DIMS") or {}).get(name)
    if known is not None and len(shape) <= len(known):
        return known[len(known) - len(shape) :]
    first = along(cm) if shape[:1] == (states,) else f"{name}_dim_0"
    return tuple(f"{name}_dim_{i}" if i else first for i in range(len(shape)))


def _declared(cm: ChainModel, name: str):
    return getattr(inspect.getmodule(cm.model), name, None)


def _tail(site, shape: tuple[int, ...]) -> tuple[str, ...]:
    spatial = issubclass(site.law, CTCRW | Brownian | OU | SoftBox)
    if spatial and len(shape) in (1, 2) and shape[-1] == 2:
        return ("part", "axis")[2 - len(shape) :]
    return tuple(f"{site.name}_dim_{i}" for i in range(1, len(shape) + 1))


def cut(cm: ChainModel, name: str, value: np.ndarray, states: int, n: int, present) -> np.ndarray:
    """Value (chain, draw, ...) of a site without what pads its shape.

    Parameters
    ----------
    states, n : int
        States with and without padding.
    present : (R,) bool or None
        False for receivers that pad.
    """
    dims = dims_of(cm, name, value.shape[2:], states)
    if dims[:1] == (along(cm),) and value.shape[2] == states:
        return value[:, :, :n]
    if dims[:1] == ("receiver",) and present is not None and value.shape[2] == len(present):
        return value[:, :, np.asarray(present)]
    return value


def units_of(cm: ChainModel, name: str) -> dict[str, str]:
    """Attributes of a variable: its unit, where the model states one."""
    if name == "track":
        moving = any(s.name == name and len(s.tail) == 2 for s in cm.chain)
        return {"units": "m", "units_of_velocity": "m/s"} if moving else {"units": "m"}
    unit = (_UNITS | (_declared(cm, "UNITS") or {})).get(name)
    return {"units": unit} if unit else {}
