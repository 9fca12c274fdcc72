"""How animals move: Gauss-Markov path distributions over the states at the pings."""

from maloc.movement.walks import CTCRW, OU, Brownian, Transition, ctcrw_beta, ctcrw_transition

__all__ = ["Brownian", "CTCRW", "OU", "Transition", "ctcrw_beta", "ctcrw_transition"]
