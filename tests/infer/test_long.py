"""Long tracks by windows: the same fit as in one piece."""

import importlib
from typing import Any

import numpy as np
import pytest

import maloc
from maloc.data._stages import Stages
from maloc.infer import _windows, long
from maloc.infer._model import chain_model
from maloc.infer.mode import find_mode
from maloc.model_data import to_model_data
from maloc.simulate import canal_toa
from tests import oracles

HOW = {"movement": "rw", "error": "gaussian", "receivers": "exact"}  # compile fast


@pytest.fixture(scope="module")
def pieces():
    """A track of 120 pings, 11 of them heard by one receiver alone, in one piece and in windows."""
    toa, _ = canal_toa(np.random.default_rng(5), n_pings=120, p_na=0.4, p_mp=0.0)
    heard = toa.toa.copy()
    heard[56:67, 1:] = np.nan  # about a seam: neighbours far away must be felt through it
    heard[56:67, 0] = toa.first[56:67] + 0.1
    args = (to_model_data(toa.replace(toa=heard)),)
    cm = chain_model(maloc.models.toa_track, HOW, args)
    args = long.long_arguments(args, cm, 28)
    assert args is not None and len(args[0].valid) == 136
    return cm, args, maloc.infer.laplace(maloc.models.toa_track, *args, **HOW)


def test_derivatives_add_up(pieces):
    cm, args, _ = pieces
    windows = _windows.Windows(cm, args, 28)
    rng = np.random.default_rng(0)
    x, u = rng.normal(0, 40, (136, cm.d)), rng.normal(0, 0.4, cm.k)
    for whole, parts in (
        (cm.exact(x, u, args, 0.0), windows.exact(x, u, args, 0.0)),
        (cm.terms(x, u, args, 5.0, True), windows.terms(x, u, args, 5.0, True)),
    ):
        for a, b in zip(whole, parts, strict=True):
            np.testing.assert_allclose(b, a, rtol=1e-9, atol=1e-9 * np.abs(a).max())
    for whole, parts in zip(cm.cross(x, u, args), windows.cross(x, u, args), strict=True):
        np.testing.assert_allclose(parts, whole, atol=1e-7 * np.abs(whole).max())


def test_seams_do_not_show(pieces):
    cm, args, whole = pieces
    block = importlib.import_module("maloc.infer.laplace")._block
    fit = long.fit_long(cm, args, None, block, None, Stages(), 28)
    assert fit.converged
    sd = np.sqrt(np.einsum("tii->ti", whole.moments()[1]))
    off = np.abs(fit.x - whole.marginal.x)[: len(sd)] / sd
    assert off.max() < 0.05
    u_sd = np.sqrt(np.diag(whole.marginal.covariance))
    assert (np.abs(fit.u - whole.marginal.u) / u_sd).max() < 0.2
    np.testing.assert_allclose(np.sqrt(np.diag(fit.covariance)), u_sd, rtol=0.25)
    np.testing.assert_allclose(
        fit.factor.covariances()[:120],
        whole.marginal.factor.covariances()[:120],
        rtol=0.1,
        atol=1e-2,
    )


def test_windows_settle_with_their_ends_held(pieces):
    """From a path that is off everywhere: inside a window nothing is left to gain, ends stay."""
    cm, args, whole = pieces
    mode, u = np.asarray(whole.marginal.x), np.asarray(whole.marginal.u)
    x = mode + np.random.default_rng(3).normal(0, 0.5, mode.shape)
    own, place = _windows.cut(args, 27, 55), slice(27, 55)
    held: Any = _windows._Held(cm, True, True)
    found = find_mode(held, own, x[place], u, tol=1e-12)
    assert found.converged
    np.testing.assert_array_equal(found.x[[0, -1]], x[place][[0, -1]])
    gradient = np.asarray(cm.exact(found.x, u, own, 0.0)[1])
    assert np.abs(gradient[1:-1]).max() < 1e-4 < np.abs(gradient[[0, -1]]).max()
    band = oracles.from_band(held.exact(found.x, u, own, 0.0)[2])
    dense = oracles.from_band(np.asarray(cm.exact(found.x, u, own, 0.0)[2]))
    inner = slice(cm.d, -cm.d)
    np.testing.assert_allclose(band[inner, inner], dense[inner, inner])
    assert not band[: cm.d, cm.d :].any() and not band[inner, -cm.d :].any()
    # all windows, then all seams: what is left is what neighbours do to one another
    sd = np.sqrt(np.einsum("tii->ti", whole.marginal.factor.covariances()))
    settled = _windows.settled(cm, args, x, u, 28)
    before, after = (np.abs((p - mode) / sd)[:120].max() for p in (x, settled))
    assert after < 0.2 < before


def test_short_tracks_and_other_models_are_left_alone(pieces):
    cm, args, _ = pieces
    assert long.long_arguments(args, cm) is None
    assert long.long_arguments((np.zeros(5000),), cm, 28) is None
