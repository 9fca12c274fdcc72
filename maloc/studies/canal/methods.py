"""The methods of the canal study, side by side: each turns a case into positions and widths.

A new method is a function of (case, settings) and one line in `METHODS`; those of the classical
chain are in `maloc.studies.canal.chain`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from maloc.errors import FitError, InputError
from maloc.studies.canal.chain import CHAIN
from maloc.studies.canal.located import Located, of_points

if TYPE_CHECKING:
    from maloc.data.arrivals import ArrivalTimes, Schedule
    from maloc.infer.result import Fit
    from maloc.studies.canal.cases import Case
    from maloc.studies.canal.settings import Settings

__all__ = ["METHODS", "Located", "check_methods", "timed"]


def _toa(case: Case, settings: Settings) -> Located:
    """`maloc.models.toa_track` by Laplace."""
    import maloc

    return _of_fit(maloc.infer.laplace(maloc.models.toa_track, case.toa), case, settings)


def _yaps(case: Case, settings: Settings) -> Located:
    """`maloc.models.yaps`, the peer on the same engine, by Laplace."""
    import maloc

    return _of_fit(maloc.infer.laplace(maloc.models.yaps, case.toa), case, settings, between=False)


def _nuts(case: Case, settings: Settings) -> Located:
    """The same by NUTS, started from Laplace."""
    return _sampled(case, settings, "nuts")


def _hmc(case: Case, settings: Settings) -> Located:
    """The same by HMC."""
    return _sampled(case, settings, "hmc")


def _sampled(case: Case, settings: Settings, method: str) -> Located:
    import maloc
    from maloc._jax import jax

    fit = maloc.infer.nuts(
        jax.random.key(settings.seed),
        maloc.models.toa_track,
        case.toa,
        draws=settings.draws,
        method=method,
        progress=False,
    )
    return _of_fit(fit, case, settings)


def _known(case: Case, settings: Settings) -> Located:
    """`toa_track` given its true hyperparameters (`maloc.studies.canal.known`)."""
    import maloc
    from maloc.studies.canal.known import true_values

    values = true_values(case.toa, case.truth, case.emission)
    fit = maloc.infer.laplace(_given, case.toa, values)
    return _of_fit(fit, case, settings, between=False)  # the bridge draws its parameters


def _given(toa, values):
    """`toa_track` with parameters held at given values, which are data to the compiled engine."""
    from numpyro import handlers

    import maloc

    handlers.condition(maloc.models.toa_track, data=values)(toa)


def _joint(case: Case, settings: Settings) -> Located:
    """`maloc.models.joint` by Laplace: silence counts, of the pings that nobody heard too."""
    import maloc

    rows = np.flatnonzero(case.toa.n_heard > 0)
    rows = np.arange(rows[0], rows[-1] + 1)  # before and after, nothing is known of the tag
    history = maloc.arrival_history(_rows_of(case.toa, rows, case.toa.schedule), known=True)
    fit = maloc.infer.laplace(maloc.models.joint, history)
    ping = np.asarray(fit.args[0].ping)[: fit.n_states]
    if ping.sum() != len(rows):
        raise FitError(f"{int(ping.sum())} positions for {len(rows)} pings")
    mean, covariance, *limits = fit.positions()
    sds = np.sqrt(np.einsum("tii->ti", covariance))
    position, sd, low, high = (np.full((len(case.toa), 2), np.nan) for _ in range(4))
    for whole, part in zip((position, sd, low, high), (mean, sds, *limits), strict=True):
        whole[rows] = part[ping]
    return Located(position, sd, low, high, tuple(fit.warnings), _cpu(fit))


def _rows_of(toa: ArrivalTimes, rows: np.ndarray, schedule: Schedule) -> ArrivalTimes:
    from maloc.data.arrivals import ArrivalTimes

    return ArrivalTimes(toa.toa[rows], toa.receivers, toa.sound_speed[rows], schedule=schedule)


def _cpu(fit: Fit) -> float:
    return float(sum(stage["cpu"] for stage in fit.seconds.values()))


def _of_fit(fit: Fit, case: Case, settings: Settings, between: bool = True) -> Located:
    """Posterior moments of the heard pings; of the others, where asked, by the track's bridge."""
    from maloc.data.arrivals import Schedule
    from maloc.infer.track import track_table

    heard = case.toa.n_heard > 0
    toa, rows = case.toa, np.ones(len(heard), bool)
    if not between:
        toa, rows = _rows_of(toa, np.flatnonzero(heard), Schedule("unknown")), heard
    table = track_table(fit, toa, seed=settings.seed)
    if len(table) != rows.sum():  # pings that only the schedule calls for have no truth
        table, rows = table.filter(table["heard"]), heard
    if len(table) != rows.sum():
        raise FitError(f"{len(table)} positions for {int(rows.sum())} pings")
    parts = [np.full((len(heard), 2), np.nan) for _ in range(4)]
    names = (("x", "y"), ("sd_x", "sd_y"), ("x_lo", "y_lo"), ("x_hi", "y_hi"))
    for part, columns in zip(parts, names, strict=True):
        part[rows] = table.select(columns).to_numpy()
    return Located(*parts, warnings=tuple(fit.warnings), cpu=_cpu(fit))


def _pmc(case: Case, settings: Settings) -> Located:
    """Every ping by itself: population Monte Carlo."""
    from maloc.points import locate

    return of_points(locate(case.toa, "pmc", seed=settings.seed))


def _consensus(case: Case, settings: Settings) -> Located:
    """Every ping by itself: the arrivals that agree."""
    from maloc.points import locate

    return of_points(locate(case.toa, "consensus"))


METHODS: dict[str, Callable[[Case, Settings], Located]] = {
    "toa": _toa,
    "yaps": _yaps,
    "nuts": _nuts,
    "hmc": _hmc,
    "joint": _joint,
    "toa-known": _known,
    "pmc": _pmc,
    "consensus": _consensus,
    **CHAIN,
}


def check_methods(names: tuple[str, ...]) -> None:
    """Raise InputError where a method is unknown or cannot run here."""
    if not names:
        raise InputError("no method was asked for", mend=f"one of {', '.join(METHODS)}")
    if strange := [n for n in names if n not in METHODS]:
        raise InputError(f"method '{strange[0]}' is none of {', '.join(METHODS)}")


def timed(method: str, case: Case, settings: Settings) -> Located:
    """Run a method; CPU seconds are the fit's own, or else the whole call's."""
    began = time.process_time()
    found = METHODS[method](case, settings)
    if not np.isfinite(found.cpu):
        found = found._replace(cpu=time.process_time() - began)
    if not np.isfinite(found.position).any():
        raise FitError("no ping was located")
    return found
