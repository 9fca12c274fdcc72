"""
Direct and late arrivals
========================

`maloc.plots.paths`: how many arrivals of each receiver came straight, and how many by a detour.
"""

import small_study

import maloc

maloc.plots.paths(small_study.fit(), names=small_study.study().receivers.names)
