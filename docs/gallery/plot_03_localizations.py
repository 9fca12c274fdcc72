"""
Truth, what was heard, and draws
================================

`maloc.plots.localizations`: the true path, how many receivers heard each ping (open: nobody), and
posterior draws of the heard pings' positions.
"""

import small_study

import maloc

study = small_study.study()
maloc.plots.localizations(
    study.receivers,
    truth=small_study.truth(),
    n_heard=study.truth.n_heard,
    draws=small_study.fit().draws()["position"][0, ::10],
)
