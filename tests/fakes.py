"""A fit object with the surface of `maloc.infer`'s, made of plain arrays, for tests of outputs."""

from __future__ import annotations

import numpy as np


class FakeFit:
    """T heard pings of a tag going round in a circle, R receivers, everything known."""

    model_name = "toa_track"

    def __init__(self, t=30, r=6, chains=2, n=200, method="laplace", seed=0, start=100.0):
        rng = np.random.default_rng(seed)
        self.method, self.seconds, self.warnings = method, {"mode": {"wall": 0.2, "cpu": 0.1}}, ()
        self.options = {"movement": "ctcrw", "error": "ddetect", "sound_speed": "given"}
        angle = np.linspace(0, 2 * np.pi, t)
        self.mean = 40 * np.column_stack([np.cos(angle), np.sin(angle)])
        self.time = start + 30.0 * np.arange(t)
        position = self.mean + rng.normal(0, 1.5, (chains, n, t, 2))
        track = np.stack([position, rng.normal(0, 0.1, position.shape)], -2)
        self.samples = {
            "track": track,
            "position": position,
            "emission": rng.normal(0, 1, (chains, n, t)),
            "emission_time": self.time + rng.normal(0, 1e-3, (chains, n, t)),
            "sigma": rng.lognormal(0, 0.1, (chains, n)),
            "w": rng.beta(2, 20, (chains, n)),
        }
        self._residual = rng.normal(0, 1e-3, (t, r))
        self._residual[rng.random((t, r)) < 0.3] = np.nan
        self._residual[0, 0], self._residual[1, 1] = 0.08, 2e-4
        self._p = np.where(np.abs(self._residual) < 0.02, 0.99, 0.01)

    def draws(self, n=1000, seed=0):
        return self.samples

    def parameters(self):
        out = []
        for name, unit in (("sigma", "m"), ("w", "")):
            v = self.samples[name]
            low, high = np.quantile(v, [0.025, 0.975])
            sampled = self.method != "laplace"
            out.append(
                {
                    "name": name,
                    "mean": float(v.mean()),
                    "sd": float(v.std()),
                    "q2.5": float(low),
                    "q97.5": float(high),
                    "ess_bulk": 390.0 if sampled else None,
                    "ess_tail": 380.0 if sampled else None,
                    "r_hat": 1.001 if sampled else None,
                    "unit": unit,
                }
            )
        return out

    def residuals(self):
        return self._residual

    def p_direct(self):
        return self._p

    def to_datatree(self):
        import xarray as xr

        sites = {
            k: (("chain", "draw", *(f"{k}_{i}" for i in range(v.ndim - 2))), v)
            for k, v in self.samples.items()
        }
        return xr.DataTree.from_dict({"/posterior": xr.Dataset(sites)})


def fake_of(toa, method="laplace", **how):
    """A `FakeFit` of the right shape for these arrival times."""
    heard = toa.n_heard > 0
    fit = FakeFit(int(heard.sum()), toa.n_receivers, method=method)
    fit.time = toa.first[heard]
    fit.samples["emission_time"] = np.broadcast_to(fit.time, fit.samples["emission_time"].shape)
    fit._residual = np.where(toa.heard[heard], 1e-4, np.nan)
    fit._p = np.where(toa.heard[heard], 0.99, np.nan)
    fit._p[0, np.flatnonzero(toa.heard[heard][0])[0]] = 0.01
    fit.options = how
    return fit


def fake_table(fit, toa, seed=0):
    """A table with track.csv's columns, unheard pings included, positions drawn from the fit."""
    import polars as pl

    n = toa.n_pings
    x, y = 40 * np.cos(np.arange(n) / 9) + 1 / 3, 40 * np.sin(np.arange(n) / 9)
    if toa.origin is None:
        time = pl.Series([""] * n, dtype=pl.String)
    else:
        ns = toa.origin + np.round(toa.first * 1e9).astype(np.int64)
        time = pl.Series(ns).cast(pl.Datetime("ns")).dt.strftime("%Y-%m-%dT%H:%M:%S%.6fZ")
    half = 1.96 * 1.5
    return pl.DataFrame(
        {
            "tag": [toa.tag] * n,
            "time": time,
            "t": toa.first,
            "x": x,
            "y": y,
            "sd_x": np.full(n, 1.5),
            "sd_y": np.full(n, 1.5),
            "cov_xy": np.full(n, 0.1),
            "x_lo": x - half,
            "x_hi": x + half,
            "y_lo": y - half,
            "y_hi": y + half,
            "n_receivers": toa.n_heard,
            "heard": toa.n_heard > 0,
        }
    )
