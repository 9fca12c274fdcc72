"""Simulated arrays, animals, pings, receivers and clocks, with their truth. NumPy only.

Each part is a module of small functions that take their ``numpy.random.Generator`` first.

Comes in: a generator, a design.
Goes out: a study with its truth, in the containers of `maloc.data`.
Start reading: `simulation.py`.
The page: docs/cli.md, "maloc simulate".
"""

from maloc.simulate.hearing import Hearing
from maloc.simulate.simulation import SCENARIOS, Simulation, Truth, canal_toa, simulate

__all__ = ["SCENARIOS", "Hearing", "Simulation", "Truth", "canal_toa", "simulate"]
