"""
A track
=======

`maloc.plots.track`: posterior means, 95 % ellipses, receivers, and the truth where it is known.
"""

import small_study

import maloc

maloc.plots.track(small_study.fit(), small_study.study().receivers, truth=small_study.truth())
