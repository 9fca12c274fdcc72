"""
The same as a matrix
====================

`maloc.plots.sync_matrix`, with the order in which the pairs would be synchronised one by one
(`maloc.sync.find_sync_order`).
"""

import small_study

import maloc

study = small_study.long_study()
found = maloc.sync.connectivity(study.detections, study.receivers)
maloc.plots.sync_matrix(found, maloc.sync.find_sync_order(found))
