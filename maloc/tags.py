"""Many tags in one call: each by itself, or with movement that follows a law they share.

For tags that are to be written to a folder, in parallel and resumable, there is ``maloc track``;
here they come back as fits.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.errors import FitError, InputError

if TYPE_CHECKING:
    from maloc.data import ArrivalTimes
    from maloc.infer import Fit

__all__ = ["TagsFit", "fit"]


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
    trace : (steps,) array
        SVI: the evidence bound of all tags together, each under the model's own law, as it was
        climbed.
    warnings : tuple of str
        What went less than well with the whole; each fit has its own.
    """

    fits: dict[str, Fit]
    failed: dict[str, str]
    hierarchical: tuple[str, ...] = ()
    mean: np.ndarray = field(default_factory=lambda: np.zeros(0))
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    trace: np.ndarray = field(default_factory=lambda: np.zeros(0))
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
        SVI goes on from the Laplace fits, tag by tag.
    steps, particles : int
        Of SVI, see `maloc.infer.svi`.
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
        if method == "svi":
            keys = jax.random.split(jax.random.key(seed), len(tags.fits))
            with _bar(len(tags.fits), "svi", progress) as bar:
                for key, tag in zip(keys, list(tags.fits), strict=True):
                    tags.improve(key, tag, steps, particles)
                    bar.update()
    except KeyboardInterrupt:
        if not tags.fits:
            raise
        warnings.append("interrupted: what was done is kept")
    tags.learn()
    histories = [fit.history for fit in tags.better.values()]
    return TagsFit(
        tags.finished(),
        tags.failed,
        tuple(hierarchical),
        tags.mean,
        tags.covariance,
        np.sum(histories, axis=0) if histories else np.zeros(0),
        tuple(warnings),
    )


def _bar(total: int, what: str, show: bool):
    from tqdm import tqdm

    return tqdm(total=total, disable=not show, desc=what, unit="tag", leave=False)
