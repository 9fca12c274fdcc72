"""Figures draw what they are given, on the axes they are given."""

from __future__ import annotations

import numpy as np
import pytest
from fakes import FakeFit
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure

from maloc import plots
from maloc.data import Receivers
from maloc.errors import InputError
from maloc.plots._map import ellipse_axes
from maloc.plots._source import track_of

RECEIVERS = Receivers(np.array(["a", "b", "c"]), np.array([0.0, 100, 50]), np.array([0.0, 0, 80]))


@pytest.fixture
def ax():
    return Figure().add_subplot()


def _ellipses(ax):
    return [c for c in ax.collections if isinstance(c, EllipseCollection)]


def test_ellipses_hold_95_percent():
    rng = np.random.default_rng(1)
    cov = np.array([[[4.0, 2.5], [2.5, 3.0]]])
    points = rng.multivariate_normal([0, 0], cov[0], 200_000)
    width, height, angle = (v[0] for v in ellipse_axes(cov))
    a = np.radians(angle)
    along = points @ [np.cos(a), np.sin(a)] / (width / 2)
    across = points @ [-np.sin(a), np.cos(a)] / (height / 2)
    # binomial sd of the share is .0005
    assert abs((along**2 + across**2 < 1).mean() - 0.95) < 0.0025
    assert width > height


def test_ellipse_of_a_known_normal():
    width, height, angle = (v[0] for v in ellipse_axes(np.array([[[1.0, 0.0], [0.0, 9.0]]])))
    assert width == pytest.approx(2 * 3 * np.sqrt(5.991464547)) and height == pytest.approx(
        width / 3
    )
    assert abs(angle) == pytest.approx(90)


def test_map_draws_an_ellipse_a_ping_in_a_frame_of_equal_scale(ax):
    fit = FakeFit(t=17)
    truth = fit.mean + 1
    out = plots.track(fit, RECEIVERS, truth=truth, ax=ax)
    assert out is ax
    assert [len(np.asarray(c.get_offsets())) for c in _ellipses(ax)] == [17]
    assert ax.get_aspect() == 1
    labels = ax.get_legend_handles_labels()[1]
    assert {"truth", "receiver", "track"} <= set(labels)
    inside = RECEIVERS.xy
    assert (inside[:, 0] > ax.get_xlim()[0]).all() and (inside[:, 0] < ax.get_xlim()[1]).all()
    assert [t.get_text() for t in ax.texts] == ["a", "b", "c"]


def test_map_of_a_table_sets_unheard_pings_and_mirror_apart(ax):
    import polars as pl

    n = 12
    heard = np.arange(n) % 3 > 0
    table = pl.DataFrame(
        {
            "t": np.arange(n) * 30.0,
            "x": np.linspace(0, 50, n),
            "y": np.linspace(0, 20, n),
            "sd_x": np.ones(n),
            "sd_y": np.full(n, 2.0),
            "cov_xy": np.full(n, 0.5),
            "heard": heard,
            "mirror_x": np.linspace(0, 50, n),
            "mirror_y": -np.linspace(0, 20, n),
        }
    )
    found = track_of(table)
    np.testing.assert_allclose(found.cov[3], [[1.0, 0.5], [0.5, 4.0]])
    plots.track(table, RECEIVERS, ax=ax)
    assert sorted(len(np.asarray(c.get_offsets())) for c in _ellipses(ax)) == [
        (~heard).sum(),
        heard.sum(),
    ]
    assert "mirror image" in ax.get_legend_handles_labels()[1]
    assert ax.get_ylim()[0] < -20


def test_wild_ellipses_do_not_blow_up_the_frame(ax):
    cov = np.broadcast_to(np.eye(2), (5, 2, 2)).copy()
    cov[2] *= 1e10
    plots.draw_map(np.zeros((5, 2)), cov, RECEIVERS.xy, ax=ax)
    assert np.ptp(ax.get_xlim()) < 300


def test_two_tracks_share_axes(ax):
    for seed, colour in ((0, "#0072B2"), (1, "#D55E00")):
        plots.track(FakeFit(seed=seed), colour=colour, ax=ax)
    assert len(_ellipses(ax)) == 2


def test_track_from_draws_has_their_moments():
    fit = FakeFit(t=9, n=400)
    found = track_of(fit)
    draws = fit.samples["position"].reshape(-1, 9, 2)
    np.testing.assert_allclose(found.mean, draws.mean(0))
    np.testing.assert_allclose(found.cov[4], np.cov(draws[:, 4].T), rtol=1e-10)
    tree = track_of(fit.to_datatree())
    np.testing.assert_allclose(tree.mean, found.mean)


def test_what_is_no_track_is_refused():
    with pytest.raises(InputError, match="cannot plot a int"):
        plots.track(3)


def test_residuals_have_a_point_an_arrival(ax):
    fit = FakeFit(t=25, r=5)
    assert plots.residuals(fit, ax=ax) is ax
    points = ax.collections[0]
    heard = np.isfinite(fit.residuals())
    assert len(np.asarray(points.get_offsets())) == heard.sum()
    np.testing.assert_allclose(
        np.sort(np.asarray(points.get_offsets())[:, 1]), np.sort(1e3 * fit.residuals()[heard])
    )
    assert ax.get_yscale() == "symlog"  # one arrival is 80 ms late


def test_paths_add_up_to_the_arrivals_of_each_receiver(ax):
    fit = FakeFit(t=25, r=5)
    plots.paths(fit, tuple("abcde"), ax=ax)
    heights = np.array([bar.get_height() for bar in ax.patches]).reshape(2, 5)
    np.testing.assert_allclose(heights.sum(0), np.isfinite(fit.residuals()).sum(0))
    np.testing.assert_allclose(
        heights[0], np.nansum(np.where(np.isfinite(fit.residuals()), fit.p_direct(), 0), 0)
    )


@pytest.mark.parametrize("method", ["laplace", "nuts"])
def test_diagnostics_have_six_panels_that_can_be_drawn(method, tmp_path):
    figure = Figure(figsize=(14, 8))
    axes = plots.diagnostics(FakeFit(method=method), None, tuple("abcdef"), figure=figure)
    assert axes.shape == (2, 3) and all(isinstance(a, Axes) for a in axes.flat)
    title = axes[1, 2].get_title(loc="left")
    assert title.startswith("Chains" if method == "nuts" else "Intervals")
    figure.savefig(tmp_path / "d.png")
    assert (tmp_path / "d.png").stat().st_size > 10_000


def test_single_panels_return_their_axes():
    fit = FakeFit(t=10)
    panels = [
        lambda ax: plots.heard(fit.time, np.array([0, 1, 2, 3, 4, 5, 0, 2, 2, 1]), ax=ax),
        lambda ax: plots.spread(track_of(fit), ax=ax),
        lambda ax: plots.intervals(fit.time, ax=ax),
        lambda ax: plots.parameters(fit, ax=ax),
        lambda ax: plots.trace(fit, ax=ax),
    ]
    for panel in panels:
        ax = Figure().add_subplot()
        assert panel(ax) is ax
        assert ax.has_data()


def test_without_axes_a_pyplot_figure_is_made():
    from matplotlib import pyplot as plt

    ax = plots.track(FakeFit(t=5))
    assert ax.get_figure() in [plt.figure(n) for n in plt.get_fignums()]
    plt.close("all")


def test_parameters_are_written_to_two_digits_of_their_range():
    from maloc.plots._diagnostics import _digits

    assert _digits(1.00747, 1.00651, 1.00844) == ("1.0075", "1.0065", "1.0084")
    assert _digits(170.74, 127.1, 227.6) == ("171", "127", "228")
