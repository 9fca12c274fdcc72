"""YAPS's model: its density by hand, its track of a tag that keeps a beat, its benchmark."""

from __future__ import annotations

import sys

import numpy as np
import polars as pl
import pytest
from numpyro import handlers
from numpyro.infer.util import log_density
from scipy.special import expit
from scipy.stats import lognorm, norm, t

import maloc.infer
from benchmarks import yaps as benchmark
from maloc._jax import jax, jnp
from maloc.infer.initial import _T3_MIDDLE, _middle_size
from maloc.infer.long import LongFit
from maloc.model_data import to_model_data
from maloc.models import yaps
from tests.infer import cases

FREE = {"sigma_step": 0.7, "sigma": 1.3, "t_scale": 40.0, "w": 0.1}


def log_joint(toa, values, **options):
    @jax.jit
    def density(values):
        return log_density(yaps, (to_model_data(toa, pad=False),), options, values)[0]

    return float(density({k: jnp.asarray(v) for k, v in values.items()}))


def by_hand(toa, values, speed):
    """Walk, arrivals and priors of what every variant has; speed (T,) m/s is the true one."""
    toa_s, heard = toa.toa[toa.n_heard > 0], toa.heard[toa.n_heard > 0]
    xy = np.column_stack([toa.receivers.x, toa.receivers.y])
    first = np.nanmin(toa_s, axis=1)
    spread = max(1000.0, 2 * np.max(np.linalg.norm(xy[:, None] - xy, axis=-1)))
    track, emission = values["track"], values["emission"]
    total = norm.logpdf(track[0], xy.mean(0), spread).sum()
    total += norm.logpdf(emission, 0, 10 * spread).sum()
    step = FREE["sigma_step"] * np.sqrt(np.diff(first))[:, None]  # variance 2 D_xy dt
    total += norm.logpdf(np.diff(track, axis=0), 0, step).sum()
    top = first + emission / speed
    away = np.sqrt(((track[:, None] - xy) ** 2).sum(-1) + 0.25)
    late = (toa_s - top[:, None] - away / speed[:, None])[heard] * cases.SPEED
    parts = 0.9 * norm.pdf(late, 0, FREE["sigma"]), 0.1 * t.pdf(late, 3, 0, FREE["t_scale"])
    total += np.log(parts[0] + parts[1]).sum()
    total += lognorm.logpdf(0.7, 1.5) + lognorm.logpdf(1.3, 1.5, scale=2.0)
    total += lognorm.logpdf(40.0, 3.0, scale=10.0)
    total += norm.logpdf(np.log(0.1 / 0.9), -4, 3) - np.log(0.1 * 0.9)
    return total, top


def somewhere(toa):
    """Track and emission near the middle of the array."""
    rng, n = np.random.default_rng(0), int((toa.n_heard > 0).sum())
    return FREE | {"track": rng.normal(0, 20, (n, 2)), "emission": -60 + rng.normal(0, 1, n)}


def test_density_of_a_random_interval_by_hand():
    toa, _, _ = cases.toa(pings=6, unheard=(), kind="random")
    values = somewhere(toa)
    total, top = by_hand(toa, values, np.full(6, cases.SPEED))
    gap = np.diff(top)
    total += norm.logpdf(gap, 25.0, 5.0).sum()
    total += np.log(expit((gap - 19.0) / 0.02) * expit((31.5 - gap) / 0.02)).sum()
    assert log_joint(toa, values) == pytest.approx(total, rel=1e-10)


def test_density_of_a_stable_interval_and_a_walking_speed_by_hand():
    """Ping 3 was not heard: two intervals, of which the first and the one after are known."""
    toa, _, _ = cases.toa(pings=7, unheard=(3,), kind="stable")
    values = somewhere(toa)
    rng = np.random.default_rng(1)
    interval, walk = rng.normal(0, 20, 6), rng.normal(0, 2, 6)
    values |= {"interval": interval, "interval_drift": 12.0}
    values |= {"sound_speed_walk": walk, "sound_speed_sd": 0.1}
    speed = cases.SPEED + walk
    first = np.nanmin(toa.toa[toa.n_heard > 0], axis=1)
    # emission times that are nearly the sums of the intervals: the beat is kept to a microsecond
    sums = 25.0 + 1e-3 * interval[:-1]
    wide = np.full(5, 1e-3)
    sums[2] += 25.0 + 1e-3 * 0.5 * (interval[2] + interval[3])
    wide[2] = np.sqrt(12.0**2 / 2 + 2e-6)
    top = first[0] - 0.04 + np.append(0.0, np.cumsum(sums + 1e-6))
    values["emission"] = (top - first) * speed
    total, again = by_hand(toa, values, speed)
    assert again == pytest.approx(top, abs=1e-10)
    total += norm.logpdf(np.full(5, 1e-6), 0, 1e-3 * wide).sum()
    n = np.array([1, 1, 2, 1, 1])
    total += norm.logpdf(interval[0], 0, 0.02 * 25e3)
    total += norm.logpdf(np.diff(interval), 0, 12.0 * np.sqrt(n)).sum()
    total += lognorm.logpdf(12.0, 3.0)
    total += norm.logpdf(walk[0], 0, 0.01 * cases.SPEED)
    total += norm.logpdf(np.diff(walk), 0, 0.1 * np.sqrt(np.diff(first))).sum()
    total += lognorm.logpdf(0.1, 2.0, scale=0.05)
    assert log_joint(toa, values, sound_speed="walk") == pytest.approx(total, rel=1e-7)


def test_unknown_options_are_refused():
    toa, _, _ = cases.toa(pings=3, unheard=())
    for wrong in ({"error": "ddetect"}, {"sound_speed": "drifting"}):
        with pytest.raises(ValueError, match="is none of"):
            handlers.trace(handlers.seed(yaps, 0)).get_trace(toa, **wrong)


def on_a_beat():
    """A tag with a stable interval, some arrivals late: arrival times, and the truth."""
    return cases.toa(seed=3, pings=14, kind="stable", sigma=0.3, p_late=0.05, unheard=(4,))


def test_a_track_on_a_beat_is_found():
    toa, emission, truth = on_a_beat()
    fit = maloc.infer.laplace(yaps, toa, draws=10)
    assert not fit.warnings
    heard = toa.n_heard > 0
    mean, covariance, _, _ = fit.positions()
    off = mean - truth[heard]
    assert np.linalg.norm(off, axis=1).mean() < 1.0
    z2 = np.einsum("ti,tij,tj->t", off, np.linalg.inv(covariance), off)
    assert z2.max() < 25  # chi squared, 2 df: 4e-6
    x, u = fit.flat_draws()
    found = fit.cm.natural(np.asarray(fit.moments()[0]), u[0, 0], (to_model_data(toa, pad=False),))
    assert np.asarray(found["emission_time"]) == pytest.approx(emission[heard], abs=2e-3)
    # emission times are sums of the intervals
    steps = np.diff(found["emission_time"])[[0, 1, 2, -2]]
    want = 25.0 + 1e-3 * np.asarray(found["interval"])[[0, 1, 2, -3]]
    assert steps == pytest.approx(want, abs=5e-5)


def test_a_long_track_on_a_beat_is_fitted_in_one_piece(monkeypatch):
    toa = on_a_beat()[0]
    short = maloc.infer.laplace(yaps, toa, draws=10)
    monkeypatch.setattr("maloc.infer.long.LONG", 0)
    fit = maloc.infer.laplace(yaps, toa, draws=10)
    assert not isinstance(fit, LongFit)
    assert fit.moments()[0] == pytest.approx(short.moments()[0])


def test_start_of_the_t_part_is_a_weighted_median():
    """As if every residual were there as often as its weight says."""
    residual, weight = np.array([-9.0, 1.0, 4.0, -2.0, 30.0]), np.array([2, 4, 1, 3, 1])
    want = np.median(np.repeat(np.abs(residual), weight))
    assert _middle_size(residual, weight.astype(float)) == want
    assert t(3).ppf(0.75) == pytest.approx(_T3_MIDDLE, abs=1e-4)


def test_beside_yaps(tmp_path, monkeypatch, capsys):
    """The command's table, of one file; the track that the test before has compiled."""
    toa, emission, truth = on_a_beat()
    places = pl.DataFrame({"receiver": toa.receivers.receiver, "x": toa.receivers.x,
                           "y": toa.receivers.y})  # fmt: skip
    places.write_csv(tmp_path / "receivers.csv")
    columns = {f"toa_{name}": toa.toa[:, i] for i, name in enumerate(toa.receivers.receiver)}
    table = {"top": emission, "x": truth[:, 0], "y": truth[:, 1], "ss": toa.sound_speed}
    pl.DataFrame(table | columns).fill_nan(None).write_csv(tmp_path / "a_sbi.csv")
    peer = {"file": ["a_sbi.csv"], "mean": [0.4], "median": [0.4], "user_s": [10.0]}
    pl.DataFrame(peer).write_csv(tmp_path / "yaps_results.csv")
    how = ["--interval-stable", "25", ".02", "--interval", "20", "30"]
    monkeypatch.setattr(sys, "argv", ["yaps", str(tmp_path), *how])
    benchmark.main()
    said = capsys.readouterr().out.splitlines()
    row = next(s for s in said if s.startswith("a_sbi"))
    mean, ratio = float(row.split()[1]), float(row.split()[3])
    assert ratio == pytest.approx(mean / 0.4, abs=2e-3)
    assert sum(s.startswith(("a_sbi", "sbi", "all")) for s in said) == 3


def test_a_lost_track_is_marked(capsys):
    rows = [
        benchmark.Row("a_x", 2.0, 1.0, 0.5, 2.1, 1.0, 5.0, ""),
        benchmark.Row("b_y", 2.0, 1.0, 0.5, 9.0, 8.0, 5.0, ""),
    ]
    benchmark.print_rows(rows)
    said = capsys.readouterr().out
    assert "0.222*" in said and "0.952 " in said and "* 1 file(s)" in said
    assert next(s for s in said.splitlines() if s.startswith("without")).split()[4] == "0.952"
