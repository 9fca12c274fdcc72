"""Inference: Laplace and NUTS/HMC on any chain-structured NumPyro model."""

from __future__ import annotations

from maloc.infer.laplace import laplace
from maloc.infer.nuts import nuts
from maloc.infer.result import Fit, LaplaceFit, SampledFit

__all__ = ["Fit", "LaplaceFit", "SampledFit", "laplace", "nuts"]
