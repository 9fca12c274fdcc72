"""
Where an array hears
====================

`maloc.plots.audibility`: the chance that a ping sent there is heard by one receiver or more.
"""

import small_study

import maloc

receivers = small_study.study().receivers
maloc.plots.audibility(
    receivers, 0.9, 60.0, low=receivers.xy.min(axis=0) - 100, high=receivers.xy.max(axis=0) + 100
)
