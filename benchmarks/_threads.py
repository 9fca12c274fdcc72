"""One thread, so that seconds are comparable: import this before NumPy or JAX."""

from __future__ import annotations

import os

from maloc.runs.threads import ONE_THREAD

# tables are read by all threads, as users' are, and a graphics card serves where there is one
_FREE = "POLARS_MAX_THREADS", "JAX_PLATFORMS"
os.environ.update({k: v for k, v in ONE_THREAD.items() if k not in _FREE})
