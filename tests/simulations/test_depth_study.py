"""The study of depth runs from end to end."""

import pytest

from simulations import depth


@pytest.mark.extended
def test_study_of_depth(capsys):
    depth.main(["--tracks", "1", "--pings", "14"])
    said = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in said[1:5]] == ["flat", "sensed", "unknown", "known"]
    assert said[5] == "1 tracks of 14 pings, depth sd 20 m"
