"""Every name that was public before the rooms is found where it was, or says where it went."""

from __future__ import annotations

import subprocess
import sys
import warnings
from importlib import import_module
from pathlib import Path

import pytest

from maloc._package.moved import MODULES, NAMES

LINES = (Path(__file__).parent / "public_names.txt").read_text().splitlines()
BEFORE = {line.split(":")[0]: line.split()[1:] for line in LINES}


@pytest.mark.parametrize("module", BEFORE)
def test_no_public_name_is_lost(module):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        found = import_module(module)
        missing = [name for name in BEFORE[module] if not hasattr(found, name)]
    assert BEFORE[module] and missing == []


def test_a_module_that_moved_is_the_one_at_the_new_place_and_warns_once():
    code = """
import sys, warnings
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    import maloc.habitat, maloc.data.readers.vue
    from maloc.habitat import Water
    from maloc import habitat
import maloc.world.habitat, maloc.readers.vue
assert maloc.habitat is habitat is maloc.world.habitat and Water is habitat.Water
assert sys.modules["maloc.data.readers.vue"] is maloc.readers.vue
assert habitat.__name__ == habitat.__spec__.name == "maloc.world.habitat"
texts = [str(w.message) for w in said if w.category is DeprecationWarning]
assert len(texts) == 3 and all("the old name goes" in t for t in texts), texts
assert texts[0].startswith("maloc.habitat is maloc.world.habitat now"), texts
assert all(w.filename == "<string>" for w in said), [w.filename for w in said]
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=300
    )
    assert done.returncode == 0, done.stderr


def test_what_has_moved_was_public():
    assert set(MODULES) <= {*BEFORE, "maloc.data.readers"}
    for old in NAMES:
        package, _, name = old.rpartition(".")
        assert name in BEFORE[package]
        with pytest.warns(DeprecationWarning, match=f"{old} is {NAMES[old]}.{name} now"):
            getattr(import_module(package), name)


def test_what_never_was_is_not_found():
    with pytest.raises(ModuleNotFoundError):
        import_module("maloc.habitats")
    with pytest.raises(ModuleNotFoundError):
        import_module("maloc.data.readers.no_such_format")
    with pytest.raises(AttributeError, match="no_such_name"):
        import_module("maloc.data").no_such_name  # noqa: B018
