"""
Latencies of sync detections
============================

`maloc.plots.sync_latency`: how much later than at its own receiver a sync ping was heard, less the
time that the sound takes; over time and as a histogram.
"""

import matplotlib.pyplot as plt
import small_study

import maloc

common = small_study.long_clocks().apply(small_study.long_study().detections)
table = maloc.sync.latency(common, small_study.long_study().receivers)
_, (left, right) = plt.subplots(1, 2, figsize=(11, 4.5), layout="constrained")
maloc.plots.sync_latency(table, kind="error", ax=left)
maloc.plots.sync_latency(table, kind="error", histogram=True, ax=right)
