"""The study of silence: what it simulates, and once in small."""

import numpy as np
import pytest

from simulations import silence


def test_as_many_receivers_hear_a_ping_as_asked():
    for mean in (1.5, 3.2):
        design = silence.Design(pings=400, mean=mean)
        heard = [
            silence.simulate(np.random.default_rng(i), design)[0].n_heard.mean() for i in range(6)
        ]
        assert np.mean(heard) == pytest.approx(mean, rel=0.15)


def test_a_drifting_range_is_the_designs():
    """Who hears at 0.9 exp(-d^2 / 2 s^2): the log of s varies by the sd asked, or not at all."""
    xy = silence.canal_receivers().xy
    spread = []
    for drift in (0.0, 0.6):
        far = []
        for i in range(8):
            design = silence.Design(pings=300, mean=3.2, drift=drift)
            toa, path, truth = silence.simulate(np.random.default_rng(i), design)
            away = np.linalg.norm(path[:, None] - xy, axis=2) / truth["scale"]
            expected = (silence.P0 * np.exp(-0.5 * away**2)).sum(axis=1)
            blocks = np.array_split(toa.n_heard - expected, 10)
            far += [block.mean() for block in blocks]
        spread.append(np.std(far))
    assert spread[1] > 2 * spread[0]


def test_the_command_in_small(capsys):
    silence.main(["--tracks", "1", "--pings", "24", "--mean", "3.2", "--told", "times,given"])
    rows = capsys.readouterr().out.splitlines()
    assert "Design(pings=24, mean=3.2, drift=0.0, stable=False), 1 tracks, laplace" in rows[0]
    assert [row.split()[0] for row in rows[1:]] == ["method", "times", "given"]
    assert float(rows[2].split()[3]) == 1.0  # a ratio to itself
    assert float(rows[3].split()[3]) < 1.2
