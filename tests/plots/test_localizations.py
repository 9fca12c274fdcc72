"""Figures of what was heard and where a model puts it."""

import numpy as np
import pytest
from matplotlib import pyplot as plt

from maloc import plots
from maloc.simulate.hostetter_royle import Design


@pytest.fixture
def ax():
    figure, axes = plt.subplots()
    yield axes
    plt.close(figure)


def test_audibility_is_one_minus_all_silent(ax):
    """At a lone receiver the chance of being heard is p0; far away it is 0."""
    design = Design(side=1, first=0.0)
    shown = plots.audibility(
        design.receivers(), 0.6, 0.75, low=np.full(2, -6.0), high=np.full(2, 6.0), ax=ax
    )
    value = np.asarray(shown.collections[0].get_array())
    assert value.max() == pytest.approx(0.6)
    assert value[60, 60] == value.max() and value[0, 0] < 1e-10


def test_unheard_pings_are_open_and_draws_are_all_there(ax):
    receivers = Design(side=2).receivers()
    truth = np.arange(10.0).reshape(5, 2)
    n = np.array([0, 1, 0, 3, 2])
    draws = np.zeros((7, 5, 2))
    plots.localizations(receivers, truth=truth, n_heard=n, draws=draws, ax=ax, title="one")
    heard, unheard = ax.collections[:2]
    assert len(heard.get_offsets()) == 3 and len(unheard.get_offsets()) == 2
    assert tuple(unheard.get_facecolor()[0]) == (1, 1, 1, 1)
    assert list(np.diff(heard.get_sizes()[np.argsort(n[n > 0])]) > 0) == [True, True]
    assert len(ax.lines[0].get_xdata()) == 35
