"""Fits of several tags under a law that they share, kept up to date as the law is learnt."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from maloc._jax import jax
from maloc._stages import Stages
from maloc.errors import FitError
from maloc.infer import _population as law
from maloc.infer._model import ChainModel, chain_model
from maloc.infer.laplace import laplace
from maloc.infer.result import Fit, LaplaceFit
from maloc.infer.svi import SviFit, svi

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
        self.laws: dict[str, law.Law] = {}
        self.sites: dict[str, law.Site] = {}
        self.failed: dict[str, str] = {}
        self.trace: list[float] = []
        self.mean, self.covariance = np.zeros(0), np.zeros((0, 0))

    def start(self, toas, bar) -> None:
        """Laplace fits of all tags under the model's own law; those that fail are noted."""
        with bar:
            for toa in toas:
                try:
                    data = toa.to_model_data()
                    if self.names and not len(self.prior.loc):
                        self._look(data)
                    extra = (self.prior,) if self.names else ()
                    how = {"draws": self.n, "seed": self.seed, **self.options}
                    fit = laplace(self.model, data, *extra, *self.args, **how)
                except FitError as problem:
                    self.failed[toa.tag] = str(problem)
                else:
                    self.fits[toa.tag] = fit
                    m = fit.marginal
                    self._note(toa.tag, m.u, m.covariance, self.prior)
                bar.update()

    def _look(self, data) -> None:
        args = (data, *self.args)
        self.prior = law.own_law(chain_model(self.plain, self.options, args), args, self.names)

    def _rows(self, cm: ChainModel) -> np.ndarray:
        place = {s.name: s.place.start for s in cm.globals}
        return np.array([place[name] for name in self.names], int)

    def _note(self, tag: str, u, covariance, under: law.Law) -> None:
        if not self.names:
            return
        rows = self._rows(self.fits[tag].cm)
        self.laws[tag] = under
        self.sites[tag] = law.site_of(u[rows], covariance[np.ix_(rows, rows)], under)

    def learn(self) -> None:
        """The law's posterior from all sites."""
        if self.names:
            found = law.learn_population(list(self.sites.values()), self.prior)
            self.mean, self.covariance = found

    def moved(self, before: np.ndarray) -> float:
        """How far the law has moved, in its standard deviations."""
        sd = np.sqrt(np.diag(self.covariance))
        return float(np.max(np.abs(self.mean - before) / sd, initial=0.0))

    def _now(self, tag: str) -> LaplaceFit:
        """The Laplace fit of a tag under the law as it is known now."""
        fit = self.fits[tag]
        if not self.names:
            return fit
        rows, now = self._rows(fit.cm), law.expected_law(self.mean, self.covariance)
        moved = law.reweighted(fit.marginal, rows, self.prior, now)
        args = (fit.args[0], now, *fit.args[2:])
        stages = Stages(fit.seconds)
        return LaplaceFit(fit.cm, args, fit.options, stages, fit.warnings, moved, self.n, self.seed)

    def improve(self, key, tags: list[str], steps: int, particles: int, bar) -> None:
        """SVI of some tags under the law as it is known now."""
        for tag, own in zip(tags, jax.random.split(key, len(tags)), strict=True):
            how: dict[str, Any] = {"steps": steps, "particles": particles, "progress": False}
            how |= {"draws": self.n, "seed": self.seed, "checks": _RATIOS}
            try:
                fit = svi(own, self._now(tag), **how)
            except FitError as problem:
                self.failed[tag] = f"svi: {problem}"
                for kept in (self.fits, self.sites, self.laws, self.better):
                    kept.pop(tag, None)
            else:
                self.better[tag] = fit
                c = np.asarray(fit.guide.c)
                under = fit.args[1] if self.names else self.prior
                self._note(tag, np.asarray(fit.guide.u), c @ c.T, under)
            bar.update()

    def bound(self) -> float:
        """Evidence bound of all tags together, under the law as it is known now."""
        total = sum(fit.elbo for fit in self.better.values())
        if not self.names:
            return total
        h, now = len(self.names), law.expected_law(self.mean, self.covariance)
        for tag, fit in self.better.items():
            rows, c = self._rows(fit.cm), np.asarray(fit.guide.c)
            u, variance = np.asarray(fit.guide.u)[rows], np.diag(c @ c.T)[rows]
            for sign, one in ((1, now), (-1, self.laws[tag])):
                square = ((u - one.loc) ** 2 + variance) / one.scale**2
                total -= sign * float(np.sum(np.log(one.scale) + 0.5 * square))
        variance = np.diag(self.covariance)
        each = -variance[h:] - 0.5 * variance[:h] / now.scale**2
        middle = np.concatenate([self.prior.loc, np.full(h, law.TAU[0])])
        wide = np.concatenate([self.prior.scale, np.full(h, law.TAU[1])])
        own = -np.log(wide) - 0.5 * ((self.mean - middle) ** 2 + variance) / wide**2
        entropy = 0.5 * (np.linalg.slogdet(self.covariance)[1] + 2 * h)
        return total + len(self.better) * float(each.sum()) + float(own.sum()) + entropy

    def finished(self) -> dict[str, Fit]:
        """Fits of all tags under the law as it is known in the end, its uncertainty included."""
        out: dict[str, Fit] = {}
        for tag, fit in self.fits.items():
            if tag in self.better:
                out[tag] = self.better[tag]
            elif self.names and len(self.mean):
                now, h = self._now(tag), len(self.names)
                rows, one = self._rows(fit.cm), law.expected_law(self.mean, self.covariance)
                sure = self.covariance[:h, :h]
                wide = law.reweighted(fit.marginal, rows, self.prior, one, sure)
                now.marginal = wide
                out[tag] = now
            else:
                out[tag] = fit
        return out
