"""Fits of several tags under a law that they share, kept up to date as the law is learnt."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from maloc._jax import jnp
from maloc.errors import FitError
from maloc.infer import _population as law
from maloc.infer._guide import Guide
from maloc.infer._guide import _given as given
from maloc.infer._model import ChainModel, chain_model
from maloc.infer.laplace import laplace
from maloc.infer.result import Fit, LaplaceFit
from maloc.infer.svi import SviFit, svi
from maloc.model_data.toa import to_model_data

__all__ = ["Tags"]

_RATIOS = 100  # draws of the guide for its bound and k-hat


class Tags:
    """Work in progress: Laplace fits under the model's own law, sites, the law, SVI fits."""

    def __init__(
        self, model: Callable, args: tuple, options: dict, names: Sequence[str], n: int, seed: int
    ) -> None:
        self.names, self.args, self.options = tuple(names), args, options
        self.plain, self.model = model, law.shared(model, tuple(names)) if names else model
        self.n, self.seed = n, seed
        self.prior = law.Law(np.zeros(0), np.ones(0))
        self.fits: dict[str, LaplaceFit] = {}
        self.better: dict[str, SviFit] = {}
        self.sites: dict[str, law.Site] = {}
        self.failed: dict[str, str] = {}
        self.mean, self.covariance = np.zeros(0), np.zeros((0, 0))

    def start(self, toas, bar) -> None:
        """Laplace fits of all tags under the model's own law; those that fail are noted."""
        with bar:
            for toa in toas:
                try:
                    data = to_model_data(toa)
                    if self.names and not len(self.prior.loc):
                        self._look(data)
                    extra = (self.prior,) if self.names else ()
                    how = {"draws": self.n, "seed": self.seed, **self.options}
                    fit = laplace(self.model, data, *extra, *self.args, **how)
                    fit.source = toa
                except FitError as problem:
                    self.failed[toa.tag] = str(problem)
                else:
                    self.fits[toa.tag] = fit
                    m = fit.marginal
                    self._note(toa.tag, m.u, m.covariance)
                bar.update()

    def _look(self, data) -> None:
        args = (data, *self.args)
        self.prior = law.own_law(chain_model(self.plain, self.options, args), args, self.names)

    def _rows(self, cm: ChainModel) -> np.ndarray:
        place = {s.name: s.place.start for s in cm.globals}
        return np.array([place[name] for name in self.names], int)

    def _note(self, tag: str, u, covariance) -> None:
        if self.names:
            rows = self._rows(self.fits[tag].cm)
            own = covariance[np.ix_(rows, rows)]
            self.sites[tag] = law.site_of(u[rows], own, self.prior)

    def learn(self) -> None:
        """The law's posterior from all sites."""
        if self.names:
            found = law.learn_population(list(self.sites.values()), self.prior)
            self.mean, self.covariance = found

    def improve(self, key, tag: str, steps: int, particles: int) -> None:
        """SVI of a tag, under the model's own law: that alone keeps its site free of the others'.

        Under a learnt law that is narrow the site would be a small difference of two large
        precisions, one of them with Monte Carlo noise.
        """
        how: dict[str, Any] = {"steps": steps, "particles": particles, "progress": False}
        how |= {"draws": self.n, "seed": self.seed, "checks": _RATIOS}
        try:
            fit = svi(key, self.fits[tag], **how)
        except FitError as problem:
            self.failed[tag] = f"svi: {problem}"
            del self.fits[tag]
            self.sites.pop(tag, None)
            return
        self.better[tag] = fit
        c = np.asarray(fit.guide.c)
        self._note(tag, np.asarray(fit.guide.u), c @ c.T)

    def finished(self) -> dict[str, Fit]:
        """Fits of all tags under the law as it is known in the end, its uncertainty included."""
        return {tag: self._under_law(self.better.get(tag, fit)) for tag, fit in self.fits.items()}

    def _under_law(self, fit: Any) -> Fit:
        if not self.names or not len(self.mean):
            return fit
        rows, h = self._rows(fit.cm), len(self.names)
        now = law.expected_law(self.mean, self.covariance)
        how = (rows, self.prior, now, self.covariance[:h, :h])
        out = copy.copy(fit)
        out.args, out._known = (fit.args[0], now, *fit.args[2:]), {}
        if isinstance(fit, SviFit):
            out.guide = _guide_under(fit.guide, *how)
        else:
            m = fit.marginal
            u, covariance = law.reweighted(m.u, m.covariance, *how)
            x = m.x + np.einsum("k,ktd->td", u - m.u, m.slope)
            out.marginal = m._replace(x=x, u=u, covariance=covariance)
        return out


def _guide_under(guide: Guide, *how) -> Guide:
    """A guide whose parameters are reweighted; the path given them stays as it is."""
    c = np.asarray(guide.c)
    u, covariance = law.reweighted(np.asarray(guide.u), c @ c.T, *how)
    x, root, carry = given(guide, jnp.asarray(u) - guide.u)
    c = jnp.asarray(np.linalg.cholesky(covariance))
    return guide._replace(x=x, u=jnp.asarray(u), c=c, root=root, carry=carry)
