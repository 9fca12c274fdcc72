"""Every page: links lead somewhere, code runs, commands and names exist. No block is left out."""

from __future__ import annotations

import importlib
import os
import re
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from tests.docs import commands, pages, prepared

CODE = {"python", "sh", "r", "text", "bibtex"}
CELL = "{code-cell} ipython3"
# What a page's code warns of: as its text says, and ArviZ's own call of pandas.
WARNS = {"docs/checks.md": ("Estimated shape parameter", r"The inplace keyword in DataFrame")}
# Pages whose code takes longer than a few seconds.
LONG = {f"docs/{name}.md" for name in ("tutorial", "sync", "tags", "own_model", "points")}


def _with(*languages: str) -> list[str]:
    return [p for p in pages.PAGES if any(b.language in languages for b in pages.blocks(p))]


def _marked(found: list[str]) -> list:
    return [pytest.param(p, marks=pytest.mark.extended) if p in LONG else p for p in found]


def test_pages_are_found():
    assert {"README.md", "docs/index.md", "docs/decisions/index.md"} <= set(pages.PAGES)
    assert len(_with("python")) > 10 and len(_with("sh")) > 8


@pytest.mark.parametrize("page", pages.PAGES)
def test_every_block_is_of_a_kind_that_is_tested(page):
    for block in pages.blocks(page):
        directive = block.language.startswith("{") and block.language != CELL
        assert directive or block.language in (*CODE, CELL), f"line {block.line}"


@pytest.mark.parametrize("page", pages.PAGES)
def test_links_lead_somewhere(page):
    folder = (pages.ROOT / page).parent
    for kind, attribute in (("link_open", "href"), ("image", "src")):
        for line, token in pages.inline(page, kind):
            target = str(token.attrs[attribute])
            if re.match(r"https://[\w.-]+(/|$)", target):
                continue
            path, _, anchor = target.partition("#")
            file = (folder / path).resolve() if path else pages.ROOT / page
            assert file.exists(), f"line {line}: {target}"
            if anchor:
                known = pages.anchors(str(file.relative_to(pages.ROOT)))
                assert anchor in known, f"line {line}: {target}"


def test_every_page_of_the_site_is_reached():
    """Each page of docs/ stands in the table of contents of another."""
    listed = set()
    for page in pages.PAGES:
        for block in pages.blocks(page):
            if block.language == "{toctree}":
                folder = (pages.ROOT / page).parent
                for name in block.text.split():
                    found = folder.glob(f"{name}.md") if "*" in name else [folder / f"{name}.md"]
                    listed |= {os.path.relpath(f, pages.ROOT) for f in found}
    assert {p for p in pages.PAGES if p.startswith("docs/")} - listed == {"docs/index.md"}


def _run(page: str, folder: Path, monkeypatch) -> dict:
    """Run a page's Python in order, one namespace for all of it, and its shell cells."""
    import matplotlib.pyplot as plt

    monkeypatch.chdir(folder)
    path = os.environ["PATH"]
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{path}")
    names = prepared.names(page, folder)
    for message in WARNS.get(page, ()):
        warnings.filterwarnings("ignore", message=message)  # pytest restores the filters
    try:
        for block in pages.blocks(page):
            if block.language not in ("python", CELL):
                continue
            if block.text.startswith("%%sh\n"):
                script = block.text.partition("\n")[2]
                subprocess.run(["sh", "-ec", script], check=True, capture_output=True, timeout=300)
                continue
            code = compile("\n" * block.line + block.text, str(pages.ROOT / page), "exec")
            exec(code, names)
    finally:
        plt.close("all")
    return names


@pytest.mark.parametrize("page", _marked(_with("python", CELL)))
def test_python_runs(page, tmp_path, monkeypatch, capsys):
    _run(page, tmp_path, monkeypatch)


@pytest.mark.extended
def test_own_model_finds_the_animal(tmp_path, monkeypatch, capsys):
    """A model from a page: its sampled track lies where the simulated animal was."""
    import numpy as np

    found = _run("docs/own_model.md", tmp_path, monkeypatch)
    heard = found["study"].toa.n_heard > 0
    for fit in (found["fit"], found["sampled"]):
        error = np.linalg.norm(fit.positions()[0] - found["truth"][heard], axis=1)
        assert error.mean() < 4.0
    assert not found["sampled"].warnings


@pytest.mark.parametrize("page", _with("sh", CELL))
def test_commands_could_run(page):
    for block in pages.blocks(page):
        if block.language == "sh" or block.text.startswith("%%sh"):
            for line in commands.lines(block.text):
                commands.check(line)


@pytest.mark.parametrize("page", pages.PAGES)
def test_names_exist(page):
    """Dotted names of maloc, commands, extras and files of the repository in running text."""
    if page == "CHANGELOG.md":  # names that moved, too
        warnings.filterwarnings("ignore", category=DeprecationWarning)
    for line, token in pages.inline(page, "code_inline"):
        text = token.content
        try:
            if match := re.match(r"(maloc(?:\.\w+)+)", text):
                _resolve(match.group(1))
            elif re.match(r"maloc [a-z]", text):
                commands.known_options(text)
            elif re.match(r"(tests|docs|maloc|benchmarks|simulations|models|notebooks)/", text):
                made = (pages.ROOT / ".gitignore").read_text().split()
                assert (pages.ROOT / text.split("::")[0]).exists() or f"{text}/" in made, text
            commands.extras(text)
        except (AssertionError, AttributeError, ImportError) as problem:
            raise AssertionError(f"{page}, line {line}: {text}: {problem}") from problem


def _resolve(name: str) -> None:
    parts = name.split(".")
    value = importlib.import_module(parts[0])
    for i, part in enumerate(parts[1:], 2):
        try:
            value = getattr(value, part)
        except AttributeError:
            value = importlib.import_module(".".join(parts[:i]))


@pytest.mark.parametrize("page", _with("text"))
def test_synopses_name_options_that_exist(page):
    for block in pages.blocks(page):
        for line in block.text.splitlines() if block.language == "text" else ():
            if re.match(r"maloc [a-z]+ +[A-Z-]", line):
                commands.known_options(line.split("   ")[0])


@pytest.mark.parametrize("page", _with("r"))
def test_r_is_marked_and_names_columns_that_exist(page, tmp_path):
    """R is not run: the page says so, and each column named is in the table that is read."""
    text = (pages.ROOT / page).read_text(encoding="utf-8").splitlines()
    tables = {"docs/posterior.md": _track_columns, "docs/after.md": _crawl_columns}
    known = tables[page](tmp_path)
    for block in pages.blocks(page):
        if block.language == "r":
            before = " ".join(text[max(block.line - 5, 0) : block.line - 1])
            assert "not run here" in before.lower(), f"line {block.line}"
            used = set(re.findall(r"\$(\w+)|~ ([\w.]+)", block.text))
            used = {a or b for a, b in used}
            assert used and used <= known, f"line {block.line}: {sorted(used - known)}"


def _track_columns(folder: Path) -> set[str]:
    from maloc.infer.track import track_table

    return set(track_table(prepared.fitted(), prepared.arrivals()).columns)


def _crawl_columns(folder: Path) -> set[str]:
    import polars as pl

    from maloc.export import Finished, write
    from maloc.infer.track import track_table

    table = track_table(prepared.fitted(), prepared.arrivals())
    degrees = table.with_columns(longitude=pl.lit(9.0), latitude=pl.lit(46.0))
    write(Finished(degrees, "EPSG:32632", None), folder / "crawl.csv", "crawl")
    return set(pl.read_csv(folder / "crawl.csv").columns)


def test_gallery_has_every_figure(root_dir):
    from maloc import plots

    files = list((root_dir / "docs" / "gallery").glob("plot_*.py"))
    drawn = {n for f in files for n in re.findall(r"maloc\.plots\.(\w+)\(", f.read_text("utf-8"))}
    assert drawn == set(plots.__all__)


def _figures() -> list[Path]:
    return sorted((pages.ROOT / "docs" / "gallery").glob("plot_*.py"))


@pytest.mark.extended
@pytest.mark.parametrize("file", _figures(), ids=lambda f: f.stem)
def test_gallery_runs(file, monkeypatch):
    import runpy

    import matplotlib.pyplot as plt

    monkeypatch.syspath_prepend(str(file.parent))
    runpy.run_path(str(file))
    assert plt.get_fignums()
    plt.close("all")
