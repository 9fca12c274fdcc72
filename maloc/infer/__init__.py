"""Inference: Laplace, NUTS/HMC and SVI on any chain-structured NumPyro model.

Comes in: a NumPyro function whose path sites are ordered in time, and its data.
Goes out: a `Fit`.
Start reading: `laplace.py`, then `_model.py` (the chain), `mode.py`, `marginal.py`, `nuts.py`;
    `_fit.py` is what a fit holds, `result.py` what can be asked of it. Knows no fish.
The mathematics: docs/architecture.md, "Inference" and "Bridges".
"""

from __future__ import annotations

from maloc.infer._arviz import read_posterior
from maloc.infer._replicate import unobserved
from maloc.infer.criticism import InputCheck, InputChecks, check_inputs
from maloc.infer.laplace import laplace
from maloc.infer.loo import loo_by_ping
from maloc.infer.nuts import nuts
from maloc.infer.predict import Prediction, TrackDraws
from maloc.infer.result import Fit, LaplaceFit, SampledFit
from maloc.infer.svi import SviFit, svi

__all__ = [
    "Fit",
    "InputCheck",
    "InputChecks",
    "LaplaceFit",
    "Prediction",
    "SampledFit",
    "SviFit",
    "TrackDraws",
    "check_inputs",
    "laplace",
    "loo_by_ping",
    "nuts",
    "read_posterior",
    "svi",
    "unobserved",
]
