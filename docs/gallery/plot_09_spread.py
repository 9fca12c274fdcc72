"""
Standard deviations over time
=============================

`maloc.plots.spread` wants an object with the pings' times, the positions' covariances, and which
pings were heard.
"""

from types import SimpleNamespace

import small_study

import maloc

fit = small_study.fit()
_, covariance, _, _ = fit.positions()
time = fit.draws()["emission_time"].mean(axis=(0, 1))
track = SimpleNamespace(time=time, cov=covariance, heard=time == time)
maloc.plots.spread(track)
