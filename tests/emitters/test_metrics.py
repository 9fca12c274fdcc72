"""GOSPA and OSPA against all permutations, and against Stone Soup's."""

from datetime import datetime

import numpy as np
import pytest

from maloc.emitters import gospa, ospa
from maloc.errors import InputError
from tests.oracles import gospa_by_permutations


@pytest.mark.parametrize("shape", [(0, 0), (0, 3), (2, 0), (3, 3), (4, 2), (2, 5)])
@pytest.mark.parametrize("p", [1.0, 2.0])
def test_against_all_assignments(shape, p):
    rng = np.random.default_rng(sum(shape))
    for _ in range(10):
        truth, estimate = (rng.uniform(0, 30, (n, 2)) for n in shape)
        got = gospa(truth, estimate, 10.0, p)
        assert got.distance == pytest.approx(gospa_by_permutations(truth, estimate, 10.0, p))
        assert got.missed == shape[0] - (got.pair >= 0).sum()
        assert got.false == shape[1] - (got.pair >= 0).sum()


def test_against_stone_soup():
    pytest.importorskip("stonesoup")
    from stonesoup.metricgenerator.ospametric import GOSPAMetric, OSPAMetric
    from stonesoup.types.state import State

    rng = np.random.default_rng(1)
    when = datetime(2026, 1, 1)
    for n, m in ((3, 3), (4, 2), (2, 4)):
        truth, estimate = rng.uniform(0, 20, (n, 2)), rng.uniform(0, 20, (m, 2))
        states = [[State(x[:, None], timestamp=when) for x in xs] for xs in (estimate, truth)]
        theirs, _ = GOSPAMetric(c=10.0, p=2.0).compute_gospa_metric(*states)
        assert gospa(truth, estimate, 10.0).distance == pytest.approx(theirs.value["distance"])
        theirs = OSPAMetric(c=10.0, p=2.0).compute_OSPA_distance(*states)
        assert ospa(truth, estimate, 10.0) == pytest.approx(theirs.value)


def test_two_empty_sets_are_the_same():
    assert gospa(np.empty((0, 2)), np.empty((0, 2)), 5.0).distance == 0.0
    assert ospa(np.empty((0, 2)), np.empty((0, 2)), 5.0) == 0.0
    assert ospa(np.zeros((1, 2)), np.empty((0, 2)), 5.0) == 5.0


def test_bad_input_is_refused():
    with pytest.raises(InputError, match="must be"):
        gospa(np.zeros((2, 2)), np.zeros((2, 3)), 1.0)
    with pytest.raises(InputError, match="positive"):
        gospa(np.zeros((2, 2)), np.zeros((2, 2)), 0.0)
