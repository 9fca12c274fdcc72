import numpy as np

from maloc.sync._pings import associate


def test_pings_echoes_and_tags_are_kept_apart():
    #            ping 1: A B B(echo)       ping 2: B A      other tag
    emission = np.array([10.0, 10.01, 10.2, 40.0, 40.02, 10.0])
    receiver = np.array([0, 1, 1, 1, 0, 0])
    tag = np.array([0, 0, 0, 0, 0, 1])
    order = np.random.default_rng(0).permutation(6)
    ping, first = associate(tag[order], receiver[order], emission[order], 0.5)
    back = np.argsort(order)
    np.testing.assert_array_equal(ping[back], [0, 0, 0, 1, 1, 2])
    np.testing.assert_array_equal(first[back], [True, True, False, True, True, True])


def test_nothing_in_nothing_out():
    empty = np.zeros(0)
    ping, first = associate(empty.astype(int), empty.astype(int), empty, 0.5)
    assert len(ping) == len(first) == 0
