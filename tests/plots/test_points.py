"""Figures of single pings and of how well an array locates."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib import pyplot as plt

from maloc import Receivers, plots
from maloc.points import expected_error, locate
from tests.points.arrays import arrivals, ring


@pytest.fixture
def ax():
    figure, axes = plt.subplots()
    yield axes
    plt.close(figure)


@pytest.mark.parametrize("what", ["gdop", "error", "located"])
def test_maps_of_an_array_show_the_grid(ax, what):
    receivers = ring(6)
    found = expected_error(receivers, sigma=1.5, detection=("halfnormal", 0.9, 250.0), draws=60)
    shown = plots.gdop(found, receivers, what=what, ax=ax)
    assert shown is ax and ax.get_aspect() == 1
    mesh = np.ma.asarray(ax.collections[0].get_array())
    value = getattr(found, what)
    np.testing.assert_array_equal(mesh.mask, ~np.isfinite(value))
    np.testing.assert_allclose(mesh.compressed(), value[np.isfinite(value)])
    assert ax.get_xlabel() == "x (m)" and ax.get_title(loc="left")
    stations = ax.lines[-1].get_xydata()
    np.testing.assert_allclose(stations, receivers.xy)
    assert len(ax.figure.axes) == 2  # the colour bar


def test_array_that_locates_nothing_is_an_empty_map(ax):
    line = Receivers(np.array(list("abc")), np.arange(3) * 100.0, np.zeros(3))
    found = expected_error(line, x=np.array([-50.0, 300]), y=np.array([0.0]))
    assert np.isinf(found.error).all()
    assert plots.gdop(found, ax=ax, what="error") is ax
    assert np.ma.asarray(ax.collections[0].get_array()).mask.all()


def test_ambiguous_pings_are_tied_to_their_second_place(ax):
    line = Receivers(np.array(list("abcd")), np.arange(4) * 100.0, np.zeros(4))
    points = locate(arrivals(line, np.array([[120.0, 40.0], [210.0, 80.0]])), sigma=1.0)
    assert points.ambiguous.all()
    shown = plots.points(points, line, ax=ax)
    assert shown is ax
    ties = [c for c in ax.collections if hasattr(c, "get_segments")][0].get_segments()
    np.testing.assert_allclose([t[0] for t in ties], points.position)
    np.testing.assert_allclose([t[1] for t in ties], points.alternative)
    assert {"second place", "receiver", "ping"} <= {
        t.get_text() for t in ax.get_legend().get_texts()
    }
