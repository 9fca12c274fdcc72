"""The one place where JAX is imported and switched to 64-bit.

Movement covariances and clock offsets need 1e-10 relative precision, which single precision
cannot give. Every module that wants JAX writes ``from maloc._jax import jax, jnp``, so that the
switch is thrown exactly when JAX is first needed and nowhere else. The same place points JAX's
persistent compilation cache at a folder of the user's (``MALOC_CACHE_DIR``; empty = no cache).
"""

from __future__ import annotations

import os
from pathlib import Path

from maloc._package.version import warn_outside

warn_outside()  # before the imports that an unsupported version may fail in

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402

from maloc.errors import FitError  # noqa: E402

__all__ = ["jax", "jnp", "require_x64"]


def _cache_dir() -> str | None:
    """Folder of the persistent compilation cache, or None where the user wants none."""
    asked = os.environ.get("MALOC_CACHE_DIR")
    if asked is not None:
        return asked or None
    if os.environ.get("JAX_COMPILATION_CACHE_DIR"):
        return os.environ["JAX_COMPILATION_CACHE_DIR"]
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return str(Path(base) / "maloc" / "jax")


jax.config.update("jax_enable_x64", True)
if (_dir := _cache_dir()) is not None:
    jax.config.update("jax_compilation_cache_dir", _dir)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def require_x64() -> None:
    """Raise if somebody has switched 64-bit off since `maloc` switched it on.

    Raises
    ------
    FitError
        If ``jax_enable_x64`` is off.
    """
    if not jax.config.jax_enable_x64:  # type: ignore[attr-defined]
        raise FitError(
            "64-bit JAX was switched off; maloc needs it: jax.config.update('jax_enable_x64', True)"
        )
