"""Laplace approximation: mode of the path, parameters by their marginal likelihood."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from maloc._jax import require_x64
from maloc.data._stages import Stages
from maloc.data.water_column import flat_warning
from maloc.errors import FitError
from maloc.infer._model import ChainModel, chain_model
from maloc.infer._stretches import straighten
from maloc.infer.initial import initial_values, repair, stable_interval
from maloc.infer.long import LongFit, fit_long, long_arguments
from maloc.infer.marginal import MarginalFit, maximise_marginal
from maloc.infer.mode import _factor, find_mode
from maloc.infer.point_start import checked_positions
from maloc.infer.result import LaplaceFit
from maloc.infer.starts import beat_start, joint_starts
from maloc.model_data.convert import CONTAINERS, to_model_data
from maloc.model_data.joint import JointData
from maloc.model_data.toa import ToaData

__all__ = ["laplace"]


def laplace(
    model: Callable,
    *args,
    path: tuple[str, ...] | None = None,
    positions: np.ndarray | str | None = None,
    draws: int = 1000,
    seed: int = 0,
    **options,
) -> LaplaceFit:
    """Fit a chain-structured NumPyro model by the Laplace approximation.

    Parameters
    ----------
    model : callable
        A NumPyro model whose path sites are Markov in time (axis 0): any of `maloc.models`, or
        one of your own. Path sites are those whose distribution has ``is_chain`` (CTCRW,
        Brownian), those sampled with ``infer={"is_chain": True}``, or those named in ``path``.
    *args
        The model's arguments: arrays, pytrees of arrays, or data containers such as `ArrivalTimes`.
    path : tuple of str, optional
        Names of the path sites.
    positions : (T, 2) array or "pmc", optional
        Point positions (m) of the heard pings to start from in place of the middle of the array.
        "pmc": found ping by ping by population Monte Carlo; the better of both starts is taken.
    draws, seed : int
        Posterior draws that the fit's outputs are made of, and their seed.
    **options
        Static keyword arguments of the model.

    Returns
    -------
    LaplaceFit
        Of more than 2048 heard pings a `LongFit`: the same, found by windows; not where a model
        has a path of the burst interval.

    Raises
    ------
    FitError
        If the model has no chain, or no finite mode is found; a fit that ends short of its
        optimum is returned with a sentence in ``warnings``.

    References
    ----------
    Tierney & Kadane (1986) J. Am. Stat. Assoc. 81: 82-86; Kristensen et al. (2016) TMB, J. Stat.
    Softw. 70(5), for the marginal likelihood of the parameters.
    """
    require_x64()
    if not callable(model):
        raise TypeError(
            f"laplace(model, data, ...) takes the model first, got a {type(model).__name__}"
        )
    stages = Stages()
    with stages.time("prepare"):
        args = tuple(map(getattr(model, "reads", _same), args[:1])) + args[1:]
        source = args[0] if args and isinstance(args[0], CONTAINERS) else None
        flat = flat_warning(args[0]) if args else None
        args = tuple(map(to_model_data, args))
        cm = chain_model(model, options, args, path)
    whole = None if _walks(cm) else long_arguments(args, cm)
    try:
        if whole is None:
            fit = _fit(cm, args, path, positions, stages)
        else:
            args = whole
            with stages.time("prepare"):
                found = checked_positions(args, positions)
            fit = fit_long(cm, args, found, _block, path, stages)
    except np.linalg.LinAlgError as error:
        raise FitError(f"the path's precision cannot be factored: {error}") from error
    warnings = [flat] if flat else []
    if not np.isfinite(fit.value):
        raise FitError("no finite mode of the path was found")
    if not fit.converged:
        warnings.append("the parameters' optimum was not reached: treat widths with care")
    kind = LaplaceFit if whole is None else LongFit
    found = kind(cm, args, options, stages, tuple(warnings), fit, draws, seed)
    found.source = source
    return found


def _same(x):
    return x


def _walks(cm: ChainModel) -> bool:
    """Whether the burst interval has a path of its own: no window can find its beat alone."""
    return any(site.name == "interval" for site in cm.chain)


def _fit(cm: ChainModel, args: tuple, path, positions, stages: Stages) -> MarginalFit:
    """Start, fit, and fit again as long as pings or stretches find a better explanation."""
    with stages.time("initial"):
        found = checked_positions(args, positions)
        starts = _starts(cm, args, path, found)
        if isinstance(positions, str) and found is not None:
            starts += _starts(cm, args, path, None)
        x, u = _best(cm, args, starts)
        if not np.isfinite(_value(cm, x, u, args)):
            raise FitError("the joint density is not finite at the initial values")
    with stages.time("parameters"):
        fit = maximise_marginal(cm, args, x, u)
    for _ in range(3):
        with stages.time("initial"):
            x = repair(cm, args, straighten(cm, args, fit.x, fit.u), fit.u)
        if _value(cm, x, fit.u, args) > _value(cm, fit.x, fit.u, args) - 0.1:
            break
        with stages.time("parameters"):
            fit = maximise_marginal(cm, args, x, fit.u)
    return fit


def _block(cm: ChainModel, args: tuple, path, positions) -> MarginalFit:
    """Fit a block of a long track."""
    return _fit(cm, args, path, positions, Stages())


def _starts(cm: ChainModel, args: tuple, path, positions) -> list:
    """Starts of path and parameters, one for most models."""
    if args and isinstance(args[0], JointData) and any(s.name == "emission" for s in cm.chain):
        return list(joint_starts(cm, args, path, positions))
    return [_start(cm, args, path, positions)]


def _best(cm: ChainModel, args: tuple, starts: list) -> tuple[np.ndarray, np.ndarray]:
    """Of several starts the one whose mode has the highest Laplace marginal likelihood."""
    if len(starts) == 1:
        return starts[0]
    found = []
    for x, own in starts:
        mode = find_mode(cm, args, x, own, max_steps=25, tol=1e-3)
        band = cm.terms(mode.x, own, args, 0.0, False)[2]
        found.append((mode.value + 0.5 * _factor(band, cm.d).log_det, mode.x, own))
    return min(found, key=lambda f: f[0])[1:]


def _value(cm: ChainModel, x, u, args: tuple) -> float:
    """Negative log joint; from the function that is compiled anyway."""
    return float(cm.exact(x, u, args, 0.0)[0])


def _start(cm: ChainModel, args: tuple, path, positions) -> tuple[np.ndarray, np.ndarray]:
    """Start of path and parameters; a stable interval is switched on only after a fit without it.

    So stiff a schedule has a mode for every way of counting its milliseconds: an annealed start
    finds the right one only from a track that is already in place.
    """
    data = args[0] if args else None
    if not (isinstance(data, ToaData) and data.schedule == "stable"):
        return initial_values(cm, args, positions)
    loose = (dataclasses.replace(data, schedule="unknown"), *args[1:])
    without = chain_model(cm.model, cm.options, loose, path)
    fit = maximise_marginal(without, loose, *initial_values(without, loose, positions))
    if _walks(cm):
        return beat_start(without, fit, cm, args)
    known = without.values(fit.x, fit.u)
    values = cm.prior_medians(args) | {k: np.asarray(v) for k, v in known.items()}
    return fit.x, cm.flat_globals(stable_interval(data, fit.x[:, -1], values))
