"""Limits of central 95 % intervals and sets of the normal law."""

__all__ = ["CHI95", "Z95"]

Z95 = 1.959963984540054
CHI95 = 5.991464547107979  # chi squared with two degrees of freedom
