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
