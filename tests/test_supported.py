"""Versions that maloc was not run with are said, with both versions, and end in no traceback."""

from __future__ import annotations

import subprocess
import sys
import tomllib
import warnings
from importlib import metadata

import pytest
import typer
from packaging.specifiers import SpecifierSet
from packaging.version import Version

from maloc._package.version import SUPPORTED, outside, warn_outside
from maloc.cli.errors import explained
from maloc.errors import MalocWarning

FAKE = """
from importlib import metadata
usual = metadata.version
metadata.version = lambda name: "1.9.3" if name == "numpyro" else usual(name)
"""


@pytest.fixture
def pretend(monkeypatch):
    """Make packages look as if they had other versions."""

    def versions(**fake):
        usual = metadata.version
        monkeypatch.setattr(metadata, "version", lambda name: fake.get(name) or usual(name))

    return versions


def test_lower_bounds_are_the_packages_own(root_dir):
    project = tomllib.loads((root_dir / "pyproject.toml").read_text())["project"]
    for name, supported in SUPPORTED.items():
        (lower,) = [s for s in SpecifierSet(supported) if s.operator == ">="]
        assert f"{name}{lower}" in project["dependencies"]


def test_what_is_installed_here_is_supported():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_outside()
    assert outside() == ""


@pytest.mark.parametrize(
    ("name", "version"),
    [("arviz", "0.20.0"), ("arviz", "2.0.0"), ("numpyro", "0.23.0"), ("jax", "0.4.34.dev1")],
)
def test_both_versions_are_said(pretend, name, version):
    pretend(**{name: version})
    with pytest.warns(MalocWarning) as said:
        warn_outside()
    (one,) = said
    assert f"{name} {version}" in str(one.message) and SUPPORTED[name] in str(one.message)


@pytest.mark.parametrize(("name", "version"), [("jax", "0.12.0.1"), ("arviz", "1.3.0rc1")])
def test_inside_nothing_is_said(pretend, name, version):
    pretend(**{name: version})
    assert outside() == ""


def test_several_are_one_warning(pretend):
    pretend(arviz="0.12.0", jax="0.99")
    with pytest.warns(MalocWarning, match="jax 0.99 .*; arviz 0.12.0 ") as said:
        warn_outside()
    assert len(said) == 1


def python(code: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", FAKE + code], capture_output=True, text=True, check=False
    )
    return done.stderr + done.stdout


def test_said_once_when_jax_is_first_needed():
    assert python("import maloc") == ""
    said = python("import maloc; maloc.models.toa_track; maloc.infer.laplace; maloc.movement.CTCRW")
    assert said.count("MalocWarning: numpyro 1.9.3 is outside the range maloc supports") == 1


def test_a_command_that_fails_says_so_in_one_line(pretend, capsys):
    @explained
    def command():
        raise TypeError("__init__() got an unexpected\n keyword")

    with pytest.raises(TypeError):
        command()
    pretend(arviz="2.1.0")
    with pytest.raises(typer.Exit) as end:
        command()
    assert end.value.exit_code == 1
    said = capsys.readouterr().err
    assert said.startswith("maloc: error: arviz 2.1.0 is outside the range maloc supports (>=0.21")
    assert said.endswith("and failed: TypeError: __init__() got an unexpected keyword\n")
    assert said.count("\n") == 1


def test_a_command_warns_once(tmp_path):
    (tmp_path / "receivers.csv").write_text("receiver,x,y\nA,0,0\nB,100,0\nC,0,100\n")
    rows = [f"{20 * i},{20 * i + 0.02},{20 * i + 0.03}" for i in range(4)]
    (tmp_path / "toa.csv").write_text("\n".join(["A,B,C", *rows]) + "\n")
    args = ["maloc", "points", "--toa", str(tmp_path / "toa.csv"), "--receivers"]
    args += [str(tmp_path / "receivers.csv"), "--out", str(tmp_path / "out"), "--quiet"]
    said = python(f"import sys, maloc.cli\nsys.argv = {args}\nmaloc.cli.main()")
    assert said.count("maloc: warning: numpyro 1.9.3 is outside the range") == 1
    assert "Traceback" not in said and "MalocWarning" not in said


def test_the_bounds_are_what_was_run(root_dir):
    """The oldest leg ran every lower bound, and the ranges hold all of docs/versions.md."""
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in (root_dir / "docs" / "versions.md").read_text().splitlines()
        if line.startswith("| ")
    ]
    run = {row[0]: dict(zip(rows[0][1:], row[1:], strict=True)) for row in rows[1:]}
    project = tomllib.loads((root_dir / "pyproject.toml").read_text())["project"]
    extras = [
        e for n, e in project["optional-dependencies"].items() if n not in ("all", "docs", "test")
    ]
    for asked in [*project["dependencies"], *(a for extra in extras for a in extra)]:
        name, lower = asked.split(">=")
        oldest = Version(run[name]["oldest, 3.11"])
        assert oldest.release[: len(Version(lower).release)] == Version(lower).release, name
    for name, supported in SUPPORTED.items():
        for leg, version in run[name].items():
            assert SpecifierSet(supported).contains(version), f"{name} {version} of {leg}"
