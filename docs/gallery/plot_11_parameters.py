"""
Parameters
==========

`maloc.plots.parameters`: posterior density of every parameter, with mean and 95 % interval.
"""

import small_study

import maloc

maloc.plots.parameters(small_study.sampled())
