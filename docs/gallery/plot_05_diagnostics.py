"""
Diagnostics of a track
======================

`maloc.plots.diagnostics`: what `maloc track` writes as ``diagnostics.png``. Its panels can be had
one by one, below.
"""

import small_study

import maloc

maloc.plots.diagnostics(small_study.fit(), names=small_study.study().receivers.names)
