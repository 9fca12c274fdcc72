"""
Chains
======

`maloc.plots.trace`: the chains of a sampler, parameter by parameter. What mixes well looks like
noise; these chains are short.
"""

import small_study

import maloc

maloc.plots.trace(small_study.sampled())
