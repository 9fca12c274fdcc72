"""
Residuals of the arrivals
=========================

`maloc.plots.residuals`: each arrival against the fitted track. Late ones came by a detour; the
colour says how probable the direct path is.
"""

import small_study

import maloc

maloc.plots.residuals(small_study.fit())
