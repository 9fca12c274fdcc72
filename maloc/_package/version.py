"""The version of maloc, and those of JAX, NumPyro and ArviZ that it has been run with."""

from __future__ import annotations

import warnings

from maloc.errors import MalocWarning

__all__ = ["SUPPORTED", "__version__", "outside", "warn_outside"]

__version__ = "0.2.0"

# Lower bounds are pyproject.toml's. Above the upper ones nothing has been run: they
# are no bounds of the package, which would keep users from newer releases that may do no harm.
SUPPORTED = {"jax": ">=0.4.35,<0.13", "numpyro": ">=0.16,<0.23", "arviz": ">=0.21,<2"}


def outside() -> str:
    """What is installed outside the supported range, in one line; empty where nothing is."""
    from importlib import metadata

    from packaging.specifiers import SpecifierSet

    found = []
    for name, supported in SUPPORTED.items():
        try:
            installed = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue  # its import says so
        if not SpecifierSet(supported).contains(installed, prereleases=True):
            found.append(f"{name} {installed} is outside the range maloc supports ({supported})")
    return "; ".join(found)


def warn_outside() -> None:
    """Warn of versions outside the supported range, found without importing anything.

    Warns
    -----
    MalocWarning
        With the version found and the supported range of each.
    """
    if line := outside():
        warnings.warn(line, MalocWarning, stacklevel=2)
