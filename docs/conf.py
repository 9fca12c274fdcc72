"""How Sphinx builds the site: ``make docs`` (pages, notebooks, gallery, reference; no network)."""

from __future__ import annotations

import os
import re
import shutil
import sys
from functools import partialmethod
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE / "gallery")]
os.environ.setdefault("MPLBACKEND", "Agg")
os.environ.setdefault("MALOC_CACHE_DIR", str(HERE.parent / ".cache" / "jax"))

import write_reference  # noqa: E402
from nbclient import NotebookClient  # noqa: E402

import maloc  # noqa: E402

project = "maloc"
author = "The maloc developers"
release = version = maloc.__version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "myst_nb",
    "sphinx_gallery.gen_gallery",
]
root_doc = "index"
exclude_patterns = ["_build", "gallery", "_generated/gallery/*.ipynb", "**.ipynb_checkpoints"]
suppress_warnings = ["config.cache"]  # the gallery's functions are no part of what is cached

# Pages: headings have the anchors that GitHub gives them, so that one link serves both.
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4

# Executed pages and notebooks; kept between builds, run again when they change.
nb_execution_mode = "cache"
nb_execution_cache_path = str(HERE / "_build" / ".jupyter_cache")
nb_execution_in_temp = True
nb_execution_timeout = 600
nb_execution_raise_on_error = True
nb_merge_streams = True
# What a shell prints comes in pieces of a hundred characters; joined as they are, not line by line.
NotebookClient.__init__ = partialmethod(NotebookClient.__init__, coalesce_streams=True)
os.environ.setdefault("PYTHONWARNINGS", "ignore:IProgress not found")

# Reference: one page a module, written by write_reference from __all__.
default_role = "literal"
autosummary_generate = False
autodoc_typehints = "none"
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

sphinx_gallery_conf = {
    "examples_dirs": "gallery",
    "gallery_dirs": "_generated/gallery",
    "filename_pattern": r"/plot_",
    "ignore_pattern": r"small_study",
    "reset_modules": (),
    "download_all_examples": False,
    "show_memory": False,
    "min_reported_time": 1e9,
    "write_computation_times": False,
}

html_theme = "pydata_sphinx_theme"
html_title = f"maloc {version}"
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "show_prev_next": False,
    "navigation_with_keys": False,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": [],
    "footer_end": [],
}

# What stands beside ``docs``: where pages look for it, and where the site has it.
_BESIDE = {
    "](../notebooks/": "](/_generated/notebooks/",
    "](../CONTRIBUTING.md": "](/_generated/contributing.md",
}
_ROOT = {"CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changes.md"}


def _gather(app, config) -> None:
    """Write the reference's pages; bring in the notebooks and pages that stand beside ``docs``."""
    made = HERE / "_generated"
    for name, page in _ROOT.items():
        text = (HERE.parent / name).read_text(encoding="utf-8").replace("](docs/", "](/")
        for other, there in _ROOT.items():
            text = text.replace(f"]({other}", f"]({there}")
        made.mkdir(exist_ok=True)
        (made / page).write_text(text.replace("](/gallery)", "](/gallery.md)"), encoding="utf-8")
    write_reference.write(made / "reference")
    (made / "notebooks").mkdir(parents=True, exist_ok=True)
    for notebook in (HERE.parent / "notebooks").glob("*.ipynb"):
        copy = made / "notebooks" / notebook.name
        if not copy.exists() or copy.read_bytes() != notebook.read_bytes():
            shutil.copyfile(notebook, copy)


def _links(app, page: str, source: list[str]) -> None:
    """Links to what stands beside ``docs`` go to where it is brought in."""
    for there, here in _BESIDE.items():
        source[0] = source[0].replace(there, here)


def _skip(app, what, name, value, skip, options):
    """Fields of named tuples say nothing by themselves; the class's own docstring does."""
    doc = getattr(value, "__doc__", None) or ""
    return True if doc.startswith("Alias for field number") else None


def _door(app, what, name, value, options, lines: list[str]) -> None:
    """What a room's door says (`Comes in: ...`) is a list of fields."""
    if what == "module":
        said = re.compile(r"^(Comes in|Goes out|Start reading|The pages?|The mathematics): ")
        lines[:] = [said.sub(r":\1: ", line) for line in lines]


def setup(app) -> None:
    """Connect the functions above."""
    app.connect("config-inited", _gather, priority=1)
    app.connect("source-read", _links)
    app.connect("autodoc-skip-member", _skip)
    app.connect("autodoc-process-docstring", _door, priority=1)
