"""Clusters of hypotheses: DBSCAN as defined, and positions as good as by consensus."""

from __future__ import annotations

import numpy as np
import pytest

from maloc._jax import jnp
from maloc.points import locate
from maloc.points._cluster import dbscan
from tests.points.arrays import arrivals, error, ring


def slow_dbscan(x, eps, least):
    """Ester et al. (1996), point by point."""
    near = [np.flatnonzero(np.linalg.norm(x - p, axis=1) <= eps) for p in x]
    label = np.full(len(x), -1)
    for i in range(len(x)):
        if label[i] >= 0 or len(near[i]) < least:
            continue
        todo = [i]
        while todo:
            j = todo.pop()
            if label[j] >= 0:
                continue
            label[j] = i
            if len(near[j]) >= least:
                todo += [k for k in near[j] if label[k] < 0]
    return label


@pytest.mark.parametrize("seed", range(6))
def test_dbscan_is_the_textbooks(seed):
    rng = np.random.default_rng(seed)
    x = np.concatenate([rng.normal(c, 12, (12, 2)) for c in ([0, 0], [60, 10], [200, 0])])
    x = np.concatenate([x, rng.uniform(-300, 300, (12, 2))])[rng.permutation(48)]
    want = slow_dbscan(x, 15.0, 4)
    got = np.asarray(dbscan(jnp.asarray(x), jnp.ones(48, bool), 15.0, 4))
    assert len(np.unique(want)) > 2
    np.testing.assert_array_equal(got >= 0, want >= 0)
    # the same partition; labels of ours are the lowest core point's index, as are the textbook's
    for label in np.unique(want[want >= 0]):
        assert len(np.unique(got[want == label])) == 1


def test_unusable_points_are_noise():
    x = jnp.zeros((6, 2))
    usable = jnp.asarray([True, True, False, True, False, False])
    np.testing.assert_array_equal(dbscan(x, usable, 1.0, 3), [0, 0, -1, 0, -1, -1])
    assert (np.asarray(dbscan(x, usable, 1.0, 4)) == -1).all()


def test_clusters_withstand_late_arrivals():
    rng = np.random.default_rng(1)
    n, m = 64, 8
    receivers, xy = ring(m), rng.uniform(-300, 300, (n, 2))
    late = np.where(rng.random((n, m)) < 0.2, rng.uniform(80, 300, (n, m)), 0)
    toa = arrivals(receivers, xy, noise=rng.normal(0, 0.5, (n, m)), late=late)
    points, plain = locate(toa, "cluster", sigma=0.5), locate(toa, "least-squares", sigma=0.5)
    settled = points.located & ~points.ambiguous
    assert settled.mean() > 0.9
    assert np.median(error(points, xy)[settled]) < 0.6
    assert (error(points, xy)[settled] > 10).mean() < 0.04
    assert np.nanmean(error(points, xy)) < np.nanmean(error(plain, xy)) / 4


def test_three_receivers_give_both_roots():
    rng = np.random.default_rng(2)
    xy = rng.uniform(-700, 700, (64, 2))
    toa = arrivals(ring(3), xy)
    points = locate(toa, "cluster", sigma=0.5, reach=1e9)
    either = np.fmin(error(points, xy), np.linalg.norm(points.alternative - xy, axis=1))
    assert either.max() < 1e-2
    assert 0.05 < points.ambiguous.mean() < 0.9
