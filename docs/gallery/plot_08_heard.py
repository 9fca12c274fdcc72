"""
How many receivers heard each ping
==================================

`maloc.plots.heard`: over time; pings that nobody heard are marked.
"""

import small_study

import maloc

truth = small_study.study().truth
maloc.plots.heard(truth.time, truth.n_heard)
