"""
Residuals of the clock model
============================

`maloc.plots.sync_residuals`: what is left of the sync arrivals; late ones are drawn at the edge.
"""

import small_study

import maloc

maloc.plots.sync_residuals(small_study.long_clocks())
