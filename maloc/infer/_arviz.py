"""What differs between ArviZ 0.x, with its InferenceData, and 1.x, which works on DataTrees."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["as_arviz", "has_inference_data", "psis", "read_posterior"]


def has_inference_data() -> bool:
    """Whether the installed ArviZ is of the generation that has an InferenceData of its own.

    By its version: ArviZ 1.x from 1.1 on has the name too, for xarray's DataTree.
    """
    return int(version("arviz").split(".")[0]) < 1


def as_arviz(tree: xr.DataTree) -> Any:
    """A posterior's groups as the installed ArviZ works on them: InferenceData or DataTree."""
    if not has_inference_data():
        return tree
    import arviz as az

    groups: dict[str, Any] = {
        str(name): child.to_dataset() for name, child in tree.children.items()
    }
    return az.InferenceData(attrs=dict(tree.attrs), **groups)


def psis(log_ratios: np.ndarray) -> float:
    """Pareto shape of importance ratios (n,), log scale."""
    if has_inference_data():
        from arviz import psislw

        return float(psislw(np.asarray(log_ratios, float))[1])
    from arviz_stats.base import array_stats  # pyright: ignore[reportMissingImports]

    return float(array_stats.psislw(np.asarray(log_ratios, float))[1])


def read_posterior(path: str | Path) -> Any:
    """Read a stored posterior, NetCDF or Zarr, as the installed ArviZ works on it.

    Parameters
    ----------
    path : path
        ``posterior.nc`` of a run, or what ``fit.to_datatree()`` was written to by xarray or ArviZ
        of either generation; a folder is read as Zarr.

    Returns
    -------
    arviz.InferenceData or xarray.DataTree
        Of ArviZ 0.x an InferenceData; ArviZ 1.x works on the DataTree. The file is read whole.

    Raises
    ------
    InputError
        If there is no posterior in it.
    """
    import xarray as xr

    from maloc.errors import InputError

    path = Path(path)
    try:
        how: dict[str, Any] = {"engine": "h5netcdf"}
        if path.is_dir():
            how = {"engine": "zarr", "consolidated": False}  # which Zarr 3 has no word on
        with xr.open_datatree(path, **how) as stored:
            tree = stored.load()
    except (OSError, ValueError, KeyError) as problem:
        raise InputError(f"cannot be read as a posterior ({problem})", file=path) from None
    if "posterior" not in tree.children:
        raise InputError("holds no group 'posterior'", file=path, mend="is it a posterior.nc?")
    return as_arviz(tree)
