"""
Intervals between pings
=======================

`maloc.plots.intervals`: times between heard pings. Multiples of the burst interval tell of pings
that nobody heard.
"""

import small_study

import maloc

maloc.plots.intervals(small_study.arrivals().first)
