"""Many tags in one call: each by itself, or with movement that follows a law they share.

For tags that are to be written to a folder, in parallel and resumable, there is ``maloc track``;
here they come back as fits.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.errors import FitError, InputError

if TYPE_CHECKING:
    from maloc.data import ArrivalTimes
    from maloc.infer import Fit

__all__ = ["TagsFit", "fit"]

_STILL = 0.1  # sds; a pass that moves the law by less is the last


@dataclass
class TagsFit:
    """Fits of several tags.

    Attributes
    ----------
    fits : dict of Fit
        By tag.
    failed : dict of str
        Tags without a fit, and why.
    hierarchical : tuple of str
        Parameters whose values follow a law that the tags share: log-normal, with median exp(mu)
        and a standard deviation tau on the log scale.
    mean, covariance : (2 h,) and (2 h, 2 h) arrays
        Posterior of mu, then of log tau.
    trace : list of float
        SVI: the evidence bound of all tags together after each pass.
    warnings : tuple of str
        What went less than well with the whole; each fit has its own.
    """

    fits: dict[str, Fit]
    failed: dict[str, str]
    hierarchical: tuple[str, ...] = ()
    mean: np.ndarray = field(default_factory=lambda: np.zeros(0))
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    trace: list[float] = field(default_factory=list)
    warnings: tuple[str, ...] = ()

    def population(self) -> list[dict[str, Any]]:
        """One row a shared parameter: name, median over tags and spread (tau), with 95 % limits."""
        h, sd = len(self.hierarchical), np.sqrt(np.diag(self.covariance))
        rows = []
        for i, name in enumerate(self.hierarchical):
            row: dict[str, Any] = {"name": name}
            for what, j in (("median", i), ("spread", h + i)):
                row[what] = float(np.exp(self.mean[j]))
                low, high = np.exp(self.mean[j] + np.array([-1.96, 1.96]) * sd[j])
                row |= {f"{what}_low": float(low), f"{what}_high": float(high)}
            rows.append(row)
        return rows

    def checks(self, draws: int = 40, seed: int = 0) -> list[dict[str, Any]]:
        """One row a tag: k_hat (SVI), p of the posterior-predictive check, and what they say.

        See `maloc.infer.trust`. A tag is doubtful where its data fit worse than in 1 % of the
        replicates, or k_hat exceeds .7.
        """
        from maloc.infer.trust import K_BAD, predictive_check

        rows = []
        for tag, one in self.fits.items():
            k = getattr(one, "k_hat", float("nan"))
            p = predictive_check(one, draws, seed)
            says = []
            if k > K_BAD:
                says.append(f"k-hat {k:.2f} > {K_BAD}: not near the posterior, sample it (nuts)")
            if p < 0.01:
                says.append("the data fit worse than the model can explain")
            rows.append({"tag": tag, "k_hat": k, "p": p, "doubt": "; ".join(says)})
        return rows


def fit(
    toas: Sequence[ArrivalTimes],
    *args: Any,
    model: Callable | None = None,
    hierarchical: tuple[str, ...] = (),
    method: str = "laplace",
    batch: int = 10,
    passes: int = 3,
    steps: int = 100,
    particles: int = 2,
    draws: int = 1000,
    seed: int = 0,
    progress: bool = True,
    **options: Any,
) -> TagsFit:
    """Fit several tags, one failing not stopping the others.

    Parameters
    ----------
    toas : sequence of ArrivalTimes
        One a tag, names all different.
    *args
        Further arguments of the model, the same for all tags (`maloc.habitat.Water`).
    model : callable, optional
        `maloc.models.toa_track` where none is given.
    hierarchical : tuple of str
        Parameters with a log-normal prior ("sigma_vel", "t05", ...) whose tags' values follow a
        law that is learnt with them: tags that say little borrow from the others.
    method : {"laplace", "svi"}
        SVI starts from the Laplace fits and goes on in minibatches of tags, after each of which the
        law is learnt again.
    batch : int
        Tags a minibatch.
    passes : int
        SVI: over all tags at most; it stops earlier when a pass moves the law by less than .1 of
        its standard deviation (or there is none).
    steps, particles : int
        Of SVI, a tag and pass, see `maloc.infer.svi`.
    draws, seed : int
        As for `maloc.infer.laplace`.
    progress : bool
        Show a progress bar on stderr.
    **options
        Static options of the model.

    Returns
    -------
    TagsFit
        Interrupted by the keyboard, of the tags that are done, with a warning.

    Raises
    ------
    InputError
        If tags' names are not all different, or a hierarchical parameter is none of the model's.
    FitError
        If no tag can be fitted.

    References
    ----------
    Hoffman, Blei, Wang & Paisley (2013) Stochastic variational inference. J. Mach. Learn. Res. 14:
    1303-1347; Hughes & Sudderth (2013) Memoized online variational inference. NeurIPS 26 (what
    each tag says is kept, so that the law needs no step size).
    """
    from maloc._jax import jax
    from maloc.infer._tags import Tags
    from maloc.models import toa_track

    names = [toa.tag for toa in toas]
    if len(set(names)) < len(names) or not names:
        raise InputError("tags need names that are all different" if names else "no tags")
    if method not in ("laplace", "svi"):
        raise InputError(f"method '{method}' is neither laplace nor svi")
    tags = Tags(model or toa_track, args, options, hierarchical, draws, seed)
    warnings: list[str] = []
    try:
        tags.start(toas, _bar(len(toas), "laplace", progress))
        if not tags.fits:
            first = next(iter(tags.failed.items()))
            raise FitError(f"no tag can be fitted; {first[0]}: {first[1]}")
        tags.learn()
        if method == "svi":
            key, rng = jax.random.key(seed), np.random.default_rng(seed)
            for number in range(passes):
                before = tags.mean
                order = rng.permutation(list(tags.fits))
                with _bar(len(order), f"svi, pass {number + 1}", progress) as bar:
                    for some in np.array_split(order, -(-len(order) // batch)):
                        key, own = jax.random.split(key)
                        tags.improve(own, [str(s) for s in some], steps, particles, bar)
                        tags.learn()
                tags.trace.append(tags.bound())
                if tags.moved(before) < _STILL:
                    break
            else:
                if hierarchical and passes > 1:
                    warnings.append(f"the law of the tags still moves after {passes} passes")
    except KeyboardInterrupt:
        if not tags.fits:
            raise
        tags.learn()
        warnings.append("interrupted: what was done is kept")
    found = TagsFit(tags.finished(), tags.failed, tuple(hierarchical), tags.mean, tags.covariance)
    return replace(found, trace=tags.trace, warnings=tuple(warnings))


def _bar(total: int, what: str, show: bool):
    from tqdm import tqdm

    return tqdm(total=total, disable=not show, desc=what, unit="tag", leave=False)
