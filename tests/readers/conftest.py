"""Fixtures of the tests of readers: a case's folder, and a file made of text."""

import pytest

from maloc.readers import read_detections


@pytest.fixture
def case(shared_dir):
    def folder(number):
        (found,) = (shared_dir / "cases").glob(f"{number}-*")
        return found

    return folder


@pytest.fixture
def read(tmp_path):
    def from_text(text, reader=read_detections, name="file.csv", **options):
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return reader(path, **options)

    return from_text
