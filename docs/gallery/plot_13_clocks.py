"""
Receivers' clocks
=================

`maloc.plots.clocks`: each clock less its own straight line, with twice its standard error.
"""

import small_study

import maloc

maloc.plots.clocks(small_study.long_clocks())
