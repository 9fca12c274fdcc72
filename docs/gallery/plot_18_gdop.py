"""
How well an array would locate
==============================

`maloc.plots.gdop` of a planned array: geometric dilution of precision, the error to expect, and
the share of pings that enough receivers hear.
"""

import matplotlib.pyplot as plt
import small_study

import maloc

receivers = small_study.study().receivers
found = maloc.points.expected_error(receivers, sigma=1.0, detection=("halfnormal", 0.9, 80.0))
_, axes = plt.subplots(1, 3, figsize=(15, 4.5), layout="constrained")
for what, ax in zip(("gdop", "error", "located"), axes, strict=True):
    maloc.plots.gdop(found, receivers, what=what, ax=ax)
