"""What is built holds all of the package, and does the main job where no checkout is."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from email import message_from_string
from pathlib import Path

import polars as pl
import pytest

import maloc
from maloc.evaluate import evaluate


def run(*command: object, cwd: Path, **environment: str) -> str:
    """Run a command away from the checkout; what it said."""
    kept = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV")}
    done = subprocess.run(
        [str(c) for c in command],
        cwd=cwd,
        env=kept | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def dist(root_dir, tmp_path_factory) -> Path:
    """Folder with an sdist, and a wheel built from it, of a copy of the checkout."""
    folder = tmp_path_factory.mktemp("release")
    left = shutil.ignore_patterns("__pycache__", "*.egg-info")
    for name in ("maloc", "models"):
        shutil.copytree(root_dir / name, folder / "source" / name, symlinks=True, ignore=left)
    for file in root_dir.glob("*"):
        if file.is_file():
            shutil.copy(file, folder / "source")
    tools = {"PYTHONWARNINGS": "ignore"}
    build = [sys.executable, "-m", "build", "--no-isolation", "--outdir", folder / "dist"]
    run(*build, folder / "source", cwd=folder, **tools)
    return folder / "dist"


def test_the_wheel_holds_the_whole_package(dist, root_dir):
    (wheel,) = dist.glob("*.whl")
    assert wheel.name == f"maloc-{maloc.__version__}-py3-none-any.whl"
    files = {f.relative_to(root_dir) for f in (root_dir / "maloc").rglob("*.py")}
    wanted = {str(f) for f in files if f.parts[:2] != ("maloc", "models")}
    wanted |= {f"maloc/models/{f.name}" for f in (root_dir / "models").glob("*.py")}
    with zipfile.ZipFile(wheel) as archive:
        held = {n for n in archive.namelist() if ".dist-info/" not in n}
        info = {Path(n).name: n for n in archive.namelist() if ".dist-info/" in n}
        about = message_from_string(archive.read(info["METADATA"]).decode())
        assert b"maloc = maloc.cli:main" in archive.read(info["entry_points.txt"])
    assert held == wanted | {"maloc/py.typed"}
    assert "maloc/models/toa_track.py" in held
    assert "LICENSE" in info and about["Version"] == maloc.__version__
    assert about["Requires-Python"] == ">=3.11"
    asked = about.get_all("Requires-Dist") or []
    assert any(a.startswith("h5py>=") and "extra" not in a for a in asked)


def test_the_sdist_holds_what_builds_it(dist):
    (sdist,) = dist.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        held = {n.partition("/")[2] for n in archive.getnames()}
    assert {"pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md", "CITATION.cff"} <= held
    assert {"models/toa_track.py", "maloc/py.typed", "maloc/cli/commands.py"} <= held


@pytest.mark.extended
@pytest.mark.parametrize("kind", ["*.whl", "*.tar.gz"])
def test_installed_outside_it_does_the_main_job(dist, root_dir, tmp_path, kind):
    """In an empty environment and folder, with what users need and no more."""
    run(sys.executable, "-m", "venv", "env", cwd=tmp_path)
    python, command = tmp_path / "env/bin/python", tmp_path / "env/bin/maloc"
    (file,) = dist.glob(kind)
    pins = ["-c", root_dir / "constraints.txt"]
    run(python, "-m", "pip", "install", "--quiet", *pins, file, cwd=tmp_path)
    found = run(python, "-c", "import maloc.models as m; print(m.__file__)", cwd=tmp_path)
    assert Path(found.strip()).is_relative_to(tmp_path / "env")
    assert run(command, "--version", cwd=tmp_path) == f"maloc {maloc.__version__}\n"
    run(command, "simulate", "data", "--scenario", "canal", "--pings", 60, cwd=tmp_path)
    study = ["data/detections.csv", "--receivers", "data/receivers.csv", "--tag", "1001"]
    run(command, "track", *study, "--interval", 20.6, 36.6, "--out", "track", cwd=tmp_path)
    truth = pl.read_csv(tmp_path / "data/truth.csv")
    scores = evaluate(pl.read_csv(tmp_path / "track/track.csv"), truth).scores
    assert scores["n"] == 60 and scores["median"] < 2
    assert (tmp_path / "track/map.png").stat().st_size > 10_000
