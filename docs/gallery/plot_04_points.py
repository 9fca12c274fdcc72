"""
Positions of single pings
=========================

`maloc.plots.points`: each ping by itself, with its 95 % ellipse; ambiguous ones are tied to their
second place.
"""

import small_study

import maloc

found = maloc.points.locate(small_study.arrivals())
maloc.plots.points(found, small_study.study().receivers)
