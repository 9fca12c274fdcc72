"""
How an array hangs together
===========================

`maloc.plots.sync_map`: how often receivers heard each other's sync tags.
"""

import small_study

import maloc

study = small_study.long_study()
found = maloc.sync.connectivity(study.detections, study.receivers)
maloc.plots.sync_map(found)
