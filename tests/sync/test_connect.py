import numpy as np
import pytest

from maloc import sync
from maloc.data import Detections
from maloc.errors import InputError
from tests.sync.simulated import simulate

TRUTH = simulate(0, n_receivers=5, n_tags=4, hours=1.0, interval=(40.0, 60.0))


def test_counts_of_every_pair_by_a_plain_loop():
    found = sync.connectivity(TRUTH.detections, TRUTH.receivers)
    names = list(found.receivers.names)
    expected = np.zeros((5, 5), int)
    for tag, receiver in zip(TRUTH.detections.tag, TRUTH.detections.receiver, strict=True):
        expected[int(tag[-1]), names.index(receiver)] += 1
    np.testing.assert_array_equal(found.heard, expected)
    assert found.links[0, 1] == expected[0, 1] + expected[1, 0]
    assert (np.diagonal(found.links) == 0).all()
    assert found.heard[4].sum() == 0  # has no tag


def test_order_reaches_everybody_by_strong_links():
    found = sync.connectivity(TRUTH.detections, TRUTH.receivers)
    found.heard[:] = 0
    for (i, j), n in {(0, 1): 9, (1, 2): 7, (0, 2): 3, (2, 3): 1}.items():
        found.heard[i, j] = n
    order = sync.find_sync_order(found, "R000")
    assert order.pairs == (("R000", "R001"), ("R001", "R002"), ("R002", "R003"))
    begun = sync.sync_pair("R000", "R002").fill(found)
    assert begun.pairs == (("R000", "R002"), ("R000", "R001"), ("R002", "R003"))
    two = sync.sync_pair("R000", ["R001"]) + sync.sync_pair("R000", ["R001", "R002"])
    assert two.pairs == (("R000", "R001"), ("R000", "R002"))
    assert sync.find_sync_order(found).pairs[0][0] == "R001"
    with pytest.raises(InputError, match="controller 'X'"):
        sync.find_sync_order(found, "X")


def test_latency_on_right_clocks_is_distance_over_speed():
    d = TRUTH.detections
    time = d.time - np.round(TRUTH.offset * 1e9).astype(np.int64)
    right = Detections(time, d.receiver, d.tag)
    table = sync.latency(right, TRUTH.receivers, sound_speed=TRUTH.sound_speed)
    direct = table.filter(table["error"].abs() < 3e-3)
    assert len(direct) > 0.8 * len(table) > 500
    assert abs(direct["error"].mean()) < 1e-4  # pyright: ignore
    assert (table["error"] > -3e-3).all()  # reflections are late
    assert set(table["emitter"]) == {"R000", "R001", "R002", "R003"}
    assert (table["emitter"] != table["receiver"]).all()


def test_figures_of_links():
    from matplotlib.figure import Figure

    from maloc.plots import sync_latency, sync_map, sync_matrix

    found = sync.connectivity(TRUTH.detections, TRUTH.receivers)
    order = sync.find_sync_order(found)
    ax = sync_matrix(found, order, ax=Figure().subplots())
    assert [t.get_text() for t in ax.texts] == ["1", "2", "3", "4"]
    np.testing.assert_array_equal(np.asarray(ax.images[0].get_array()), found.heard)
    ax = sync_map(found, Figure().subplots())
    assert len(ax.lines) == np.count_nonzero(np.triu(found.links))
    table = sync.latency(TRUTH.detections, TRUTH.receivers, within=1e4)
    assert len(sync_latency(table, ax=Figure().subplots()).lines) == 4
    assert len(sync_latency(table, histogram=True, ax=Figure().subplots()).patches) == 4
