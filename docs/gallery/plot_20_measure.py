"""
Error measure against true error
================================

`maloc.classical.regress` sets an error measure against positions whose true error is known, and
its result draws itself.
"""

import numpy as np
import small_study

import maloc
from maloc.classical import geometric_error, regress

found = maloc.points.locate(small_study.study().toa)
error = np.linalg.norm(found.position - small_study.truth(), axis=1)
regress(geometric_error(found, small_study.study().receivers), error).plot()
