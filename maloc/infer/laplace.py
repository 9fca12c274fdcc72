"""Laplace approximation: mode of the path, parameters by their marginal likelihood."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from maloc._jax import require_x64
from maloc.data._stages import Stages
from maloc.data.water_column import flat_warning
from maloc.errors import FitError
from maloc.infer._effects import ALIKE, LEVEL, asked_of, carried, spells, standing_errors
from maloc.infer._late_law import late_law_may_be_other
from maloc.infer._model import ChainModel, chain_model
from maloc.infer._modes import likeliest, toa_starts
from maloc.infer._rejoin import rejoined
from maloc.infer._stretches import straighten
from maloc.infer._windows import SIZE
from maloc.infer.initial import initial_values, repair, stable_interval
from maloc.infer.long import LONG, LongFit, fit_long, long_arguments, long_effects
from maloc.infer.marginal import MarginalFit, maximise_marginal
from maloc.infer.point_start import checked_positions
from maloc.infer.result import LaplaceFit
from maloc.infer.starts import beat_start, joint_starts
from maloc.model_data.convert import CONTAINERS, to_model_data
from maloc.model_data.joint import JointData
from maloc.model_data.toa import ToaData

__all__ = ["laplace"]

_TOLD = "places and lateness of the receivers are estimated with the track (parameters.csv): "
_ERR = _TOLD + "the arrivals say that some are not where, or when, they are said to be"
_SAID = _TOLD + "errors of their places are stated"
_BELIEVED = 3.0  # m; receivers are surveyed better than that
_UNBELIEVED = "receivers would have to be {:.0f} m off, which is not believed: taken as given"
_UNBELIEVED += " (--receiver-errors estimated, or --receiver-sd, if they may be)"
_LIKELIER = 2.0  # log units
_DECAYS = "late arrivals by a law that decays (multipath): likelier than one up to a farthest wall"


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
        asked, law = asked_of(model, options, "receivers"), asked_of(model, options, "error")
        known = {"receivers": "exact"} if asked else {}
        known |= {"error": "ddetect"} if law == "auto" else {}
        cm = chain_model(model, options | known, args, path)
    whole = None if _walks(cm) else long_arguments(args, cm)
    notices: list[str] = []

    def fitted(cm):
        if whole is None:
            return _fit(cm, args, path, positions, stages)
        with stages.time("prepare"):
            found = checked_positions(args, positions)
        return fit_long(cm, args, found, _block, path, stages)

    try:
        args = args if whole is None else whole
        fit = fitted(cm)
        if law == "auto":
            options = options | {"error": "ddetect"}
            if late_law_may_be_other(cm, args, fit.x, fit.u):
                other = options | known | {"error": "multipath"}
                second = chain_model(model, other, args, path)
                tried = fitted(second)
                if whole is None:
                    tried = min(tried, _from_other(cm, fit, second, args), key=lambda f: f.value)
                if tried.value < fit.value - _LIKELIER:
                    rival = cm, fit
                    if asked in ("auto", "estimated"):
                        with stages.time("receivers"):
                            rival = _with_errors(cm, args, fit, path, options, asked)
                    if _evidence(rival[0], rival[1]) > tried.value:
                        gain, cm, fit = fit.value - tried.value, second, tried
                        options = options | {"error": "multipath"}
                        notices.append(f"{_DECAYS} (log units: {gain:.0f})")
        if asked in ("auto", "estimated"):
            with stages.time("receivers"):
                cm, fit, options, why = _with_errors(cm, args, fit, path, options, asked)
            notices += [why] if why else []
    except np.linalg.LinAlgError as error:
        raise FitError(f"the path's precision cannot be factored: {error}") from error
    warnings = [flat] if flat else []
    if not np.isfinite(fit.value):
        raise FitError("no finite mode of the path was found")
    if not fit.converged:
        warnings.append("the parameters' optimum was not reached: treat widths with care")
    if asked:
        warnings += _spells(cm, args, fit, source)
    kind = LaplaceFit if whole is None else LongFit
    found = kind(cm, args, options, stages, tuple(warnings), fit, draws, seed)
    found.source = source
    found.notices += tuple(notices)
    return found


def _spells(cm: ChainModel, args: tuple, fit: MarginalFit, source) -> list[str]:
    """A warning where arrivals err alike for stretches, which no term of the model allows for."""
    z, which = spells(cm, args, fit.x, fit.u)
    if z < ALIKE:
        return []
    names = getattr(getattr(source, "receivers", None), "labels", ())
    most = f", most of all at {names[which]}" if which < len(names) else ""
    return [
        f"arrivals at a receiver err alike for several pings{most} (z {z:.1f}): they come late or "
        "early for stretches, and the intervals are too narrow"
    ]


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
        starts = [s for s in starts if np.isfinite(_value(cm, *s, args))]
        if not starts:
            raise FitError("the joint density is not finite at the initial values")
    with stages.time("parameters"):
        fit = likeliest(cm, args, starts)[0]
    return _improved(cm, args, fit, stages)


def _improved(cm: ChainModel, args: tuple, fit: MarginalFit, stages: Stages) -> MarginalFit:
    """Fit again as long as pings or stretches find a better explanation."""
    for _ in range(3):
        with stages.time("initial"):
            x = rejoined(cm, args, fit.x, fit.u)
            x = repair(cm, args, straighten(cm, args, x, fit.u), fit.u)
        if _value(cm, x, fit.u, args) > _value(cm, fit.x, fit.u, args) - 0.1:
            break
        with stages.time("parameters"):
            fit = maximise_marginal(cm, args, x, fit.u)
    return fit


def _with_errors(plain: ChainModel, args: tuple, fit: MarginalFit, path, options, asked: str):
    """Model, fit and options with receivers' errors, where asked for or told; and what to say."""
    told = getattr(args[0], "receiver_sd", None) is not None
    exact = options | {"receivers": "exact"}
    # effects would take up what the law of late arrivals is for, and bend the map with it
    late = options.get("error") == "multipath"
    if asked == "auto" and not told and (late or _right(plain, args, fit)):
        return plain, fit, exact, ""
    options = options | {"receivers": "estimated"}
    cm = chain_model(plain.model, options, args, path)
    u = carried(plain, fit.x, fit.u, cm, args)
    if len(fit.x) > LONG * SIZE:
        found = long_effects(plain, fit, cm, args, u)
    else:
        found = maximise_marginal(cm, args, fit.x, u)
        found = _improved(cm, args, found, Stages())
    if asked == "auto":
        values = cm.values(found.x, found.u)
        size = max(float(values["receiver_sd"]), float(values["receiver_offset_sd"]))
        if size > _BELIEVED:
            return plain, fit, exact, _UNBELIEVED.format(size)
    why = "" if asked == "estimated" else _SAID if told else _ERR
    return cm, found, options, why


def _evidence(cm: ChainModel, fit: MarginalFit) -> float:
    """Negative log evidence; a standard normal effect's density has a constant that others lack."""
    return fit.value - 0.5 * np.log(2 * np.pi) * len(cm.inner)


def _from_other(cm: ChainModel, fit: MarginalFit, other: ChainModel, args: tuple) -> MarginalFit:
    """Fit of a model from where another stands."""
    u = carried(cm, fit.x, fit.u, other, args)
    return _improved(other, args, maximise_marginal(other, args, fit.x, u), Stages())


def _right(plain: ChainModel, args: tuple, fit: MarginalFit) -> bool:
    """Whether the arrivals tell of no receiver that errs for good."""
    return standing_errors(plain, args, fit.x, fit.u, fit.factor) > LEVEL


def _block(cm: ChainModel, args: tuple, path, positions) -> MarginalFit:
    """Fit a block of a long track."""
    return _fit(cm, args, path, positions, Stages())


def _starts(cm: ChainModel, args: tuple, path, positions) -> list:
    """Starts of path and parameters, one for most models."""
    if args and isinstance(args[0], JointData) and any(s.name == "emission" for s in cm.chain):
        return list(joint_starts(cm, args, path, positions))
    if args and isinstance(args[0], ToaData) and any(s.name == "emission" for s in cm.chain):
        if args[0].schedule != "stable":
            return toa_starts(cm, args, positions)
    return [_start(cm, args, path, positions)]


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
    fit = likeliest(without, loose, toa_starts(without, loose, positions))[0]
    if _walks(cm):
        return beat_start(without, fit, cm, args)
    known = without.values(fit.x, fit.u)
    values = cm.prior_medians(args) | {k: np.asarray(v) for k, v in known.items()}
    return fit.x, cm.flat_globals(stable_interval(data, fit.x[:, -1], values))
