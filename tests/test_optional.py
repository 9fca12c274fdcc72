"""What needs an optional dependency says in one line which extra brings it."""

from __future__ import annotations

import sys

import numpy as np
import pytest

import maloc.emitters
from maloc.errors import InputError, needs


def _workbook(path):
    from maloc.readers._workbook import sheets

    sheets("book.xlsx", b"")


def _raster(path):
    from maloc.readers.raster import read_raster

    read_raster(path / "dem.tif")


def _zarr(path):
    from maloc.export.arrays import zarr

    zarr(None, path / "track.zarr")  # type: ignore[arg-type]


def _geoparquet(path):
    from maloc.export.maps import geoparquet

    geoparquet(None, path / "track.parquet")  # type: ignore[arg-type]


def _tags(path):
    from maloc.runs.tags import Job, run_each

    jobs = [Job(str(i), str(i), dict, ()) for i in range(2)]
    run_each(jobs, path / "kept", workers=2, quiet=True)


def _kalman(path):
    from maloc.classical.kalman import LAWS, _bound

    _bound(np.arange(3.0), np.zeros((3, 2)), np.ones((3, 2, 2)), LAWS["rw"], (1.0,))


def _tracker(path):
    from maloc.emitters import Tracker

    Tracker(1.0, 0.1)


PLACES = {
    "openpyxl": (_workbook, "excel"),
    "rasterio": (_raster, "terrain"),
    "zarr": (_zarr, "geo"),
    "geopandas": (_geoparquet, "geo"),
    "pyarrow": (_geoparquet, "geo"),
    "distributed": (_tags, "parallel"),
    "statsmodels": (_kalman, "classical"),
    "stonesoup": (_tracker, "tracking"),
}


@pytest.mark.parametrize("module", PLACES)
def test_missing(module, monkeypatch, tmp_path):
    use, extra = PLACES[module]
    for name in [n for n in sys.modules if n.split(".")[0] == module]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.delitem(sys.modules, "maloc.emitters._stonesoup", raising=False)
    monkeypatch.delattr(
        maloc.emitters, "_stonesoup", raising=False
    )  # where another test imported it
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(InputError) as said:
        use(tmp_path)
    text = str(said.value)
    assert f'pip install "maloc[{extra}]"' in text and "\n" not in text and "fails" not in text


def test_every_extra_is_tested(root_dir):
    import tomllib

    extras = tomllib.loads((root_dir / "pyproject.toml").read_text())["project"]
    asked = set(extras["optional-dependencies"]) - {"all", "docs", "test"}
    assert asked == {extra for _, extra in PLACES.values()}


def test_broken_is_not_missing():
    problem = ImportError("cannot import name 'x' from 'y'")
    text = str(needs("this export", "Zarr", "geo", problem, file="a.zarr", otherwise="use netcdf"))
    assert text == (
        "a.zarr: this export needs Zarr, which fails (cannot import name 'x' from 'y'); "
        'pip install "maloc[geo]", or use netcdf'
    )
