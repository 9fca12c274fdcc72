"""How animals move: Gauss-Markov path distributions over the states at the pings.

Comes in: seconds between states, parameters.
Goes out: NumPyro distributions of whole paths.
Start reading: `walks.py` (CTCRW, Brownian), `ou.py`; `path.py` is what they share. Imports
    nothing of maloc but JAX.
The mathematics: docs/architecture.md, "CTCRW", "Home range".
"""

from maloc.movement.walks import CTCRW, OU, Brownian, Transition, ctcrw_beta, ctcrw_transition

__all__ = ["Brownian", "CTCRW", "OU", "Transition", "ctcrw_beta", "ctcrw_transition"]
