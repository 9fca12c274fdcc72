"""Settings that must stand before NumPy or JAX load, and the fixtures that all tests share."""

from __future__ import annotations

import gc
import os
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

# One thread a worker: the workers share the cores, and sums come out the same everywhere.
sys.path.insert(0, str(ROOT))
from maloc.runs.threads import ONE_THREAD  # noqa: E402

for _name, _value in ONE_THREAD.items():
    os.environ.setdefault(_name, _value)
# A shape that is broadcast by accident is an error in the whole suite.
os.environ.setdefault("JAX_NUMPY_RANK_PROMOTION", "raise")
# The workers share what they compile, with one another and with the next run.
os.environ.setdefault("MALOC_CACHE_DIR", str(ROOT / ".cache" / "jax"))
os.environ.setdefault("MPLBACKEND", "Agg")

import pytest  # noqa: E402
from hypothesis import HealthCheck, settings  # noqa: E402

settings.register_profile(
    "maloc",
    derandomize=True,
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("maloc")

SHARED = ROOT.parent / "shared"

# What a module imports where its tests let XLA compile: all but a few, which say so themselves.
COMPILING = re.compile(
    r"maloc\._jax|numpyro|maloc\.(infer|points|models|evaluate|simulate|predict|schedule|detection|studies)\b"
    r"|maloc import .*\b(infer|models|points|simulate|sync)\b"
    r"|CliRunner|subprocess|simulations|benchmarks|fakes"
)


def _checking(config: pytest.Config) -> bool:
    """Whether this is `make check`."""
    return "not compiles" in config.option.markexpr


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Under `make check`, leave the modules out that have to do with JAX."""
    if _checking(config) and collection_path.match("test_*.py"):
        return bool(COMPILING.search(collection_path.read_text("utf-8"))) or None
    return None


@pytest.fixture(autouse=True)
def nothing_is_compiled_unsaid(request):
    """Under `make check`, fail a test that lets XLA compile and has no marker that says so."""
    if not _checking(request.config):
        yield
        return
    import jax

    compiled: list[str] = []

    def heard(event, *_, **__):
        if event.endswith("backend_compile_duration"):
            compiled.append(event)

    jax.monitoring.register_event_duration_secs_listener(heard)
    yield
    jax.monitoring.unregister_event_duration_listener(heard)
    assert not compiled, f"XLA compiled {len(compiled)} programs: mark the test `compiles`"


@pytest.fixture(scope="session")
def shared_dir() -> Path:
    """The folder `shared` beside the checkout: real data and cases, never part of the package."""
    if not SHARED.is_dir():
        pytest.skip("the folder 'shared' with real data is not beside this checkout")
    return SHARED


@pytest.fixture(scope="session")
def root_dir() -> Path:
    """The root of the checkout."""
    return ROOT


@pytest.fixture(autouse=True, scope="module")
def room_for_compiled_code():
    """Forget compiled functions before Linux's limit of 65530 mapped regions a process is met."""
    yield
    maps = Path("/proc/self/maps")
    if "jax" in sys.modules and maps.exists() and maps.read_bytes().count(b"\n") > 20_000:
        import jax

        jax.clear_caches()
        gc.collect()
