"""Simulated arrays, animals, pings, receivers and clocks, with their truth. NumPy only.

Each part is a module of small functions that take their ``numpy.random.Generator`` first.
"""

from maloc.simulate.hearing import Hearing
from maloc.simulate.simulation import SCENARIOS, Simulation, Truth, canal_toa, simulate

__all__ = ["SCENARIOS", "Hearing", "Simulation", "Truth", "canal_toa", "simulate"]
