"""
A map from arrays
=================

`maloc.plots.draw_map` draws the same map from means and covariances, whoever found them; here the
pings' times colour the positions.
"""

import numpy as np
import small_study

import maloc

mean, covariance, _, _ = small_study.fit().positions()
receivers = small_study.study().receivers
maloc.plots.draw_map(
    mean,
    covariance,
    receivers.xy,
    names=receivers.names,
    time=np.arange(len(mean)),
    title="Ping by ping",
)
