"""The wide matrix of arrival times."""

import numpy as np
import pytest

from maloc.data import Receivers, Schedule
from maloc.errors import InputError
from maloc.readers import read_toa

R = Receivers(np.array(["a", "b", "c"]), np.array([0.0, 300.0, 0.0]), np.array([0.0, 0.0, 400.0]))


@pytest.fixture
def read(tmp_path):
    def from_text(text, receivers=R, **options):
        (tmp_path / "toa.csv").write_text(text)
        return read_toa(tmp_path / "toa.csv", receivers, **options)

    return from_text


def test_columns_by_name_in_the_order_of_the_table(read):
    text = "ping,c,toa_a,ss,depth,tag\n7,2.5,1.25,1480,3,T\n9,NA,,1481,NaN,T\n12,,9,1482,4,T\n"
    toa = read(text, schedule=Schedule("random", 1, 9))
    assert toa.receivers.names == ("a", "c")
    np.testing.assert_array_equal(toa.toa, [[1.25, 2.5], [np.nan, np.nan], [9, np.nan]])
    assert toa.ping.tolist() == [7, 9, 12] and toa.tag == "T"
    assert toa.sound_speed.tolist() == [1480, 1481, 1482] and toa.schedule.lo == 1
    np.testing.assert_array_equal(toa.depth, [3, np.nan, 4])
    assert any("left out: b" in n.text for n in toa.report.notes)
    assert read(text, sound_speed=1500).sound_speed.tolist() == [1500] * 3


def test_unix_seconds_keep_every_digit(read):
    toa = read("a,b\n1568052029.462770123,1568052029.5\n,1568052069.000000001\n", sound_speed=1500)
    assert toa.origin == 1568052029 * 10**9
    assert toa.toa[0].tolist() == [0.462770123, 0.5]
    assert toa.toa[1, 1] == 40.000000001


def test_missing_sound_speed_is_said_loudly(read):
    assert any("1500 m/s" in n.text for n in read("a,b\n1,1.1\n").report.warnings)
    assert read("a,b\n1,1.1\n").sound_speed.tolist() == [1500.0]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a,b,top,q\n1,2,3,4\n", "no receiver of the table: top, q"),
        ("top\n1\n", "no receiver of the table: top"),
        ("a,toa_a\n1,2\n", "two columns for receiver a"),
        ("a,a\n1,2\n", "two columns for receiver a"),
        ("a,b\n5,6\n1,2\n", "line 3: pings are not in time order"),
        ("a,b\n5,6\n,\n5,6\n", "line 4: the ping of line 2 is there again"),
        ("ping,a,b\n1,5,6\n1,7,8\n", "line 3, column 'ping': ping 1 is there twice"),
        ("ping,a,b\n1.5,5,6\n", "no whole number"),
        ("a,b\n5,x\n", "line 2, column 'b': 'x' is not a number"),
        ("a,b\n5,inf\n", "line 2, column 'b': a number is infinite"),
        ("a,b\n5,1568052029.5\n6,7\n8,9\n", "far from all other times"),
        ("a,b\n1568052029462,1568052029463\n", "milliseconds"),
        ("a,b\n1.568052029E9,1568052029.5\n", "exponent"),
        ("a,b,ss\n1,2,1480\n3,4,\n", "line 3, column 'ss': a sound speed is missing"),
        ("a,b\n", "no pings"),
        ("a,b,c\n1,1.1,1.2\n2,2.", "line 3: the last line is cut short"),
        ("a,b,tag\n1,2,T\n3,4,U\n", "2 tags: T, U"),
    ],
)
def test_refusals(read, text, says):
    with pytest.raises(InputError, match=says):
        read(text, ignore_columns=())


def test_one_of_several_tags(read):
    text = "a,b,tag\n1,1.1,A69-1-7\n0.5,0.6,A69-1-8\n3,3.1,A69-1-7\n"
    assert read(text, tag="7").toa[:, 0].tolist() == [1, 3]


def test_moved_receiver_needs_a_column_for_each_place(read):
    r = Receivers(
        np.array(["a", "a", "b"]),
        np.array([0.0, 9.0, 5.0]),
        np.array([0.0, 9.0, 1.0]),
        start=np.array([0, 10, 0]),
        end=np.array([10, 20, 20]),
    )
    assert read("a#2,b\n1,1.1\n", r).receivers.labels == ("a", "b")
    with pytest.raises(InputError, match="one column each"):
        read("a,b\n1,1.1\n", r)


def test_arrivals_too_far_apart_are_pointed_out(read):
    assert any("synchronised?" in n.text for n in read("a,b\n1,9\n20,20.1\n").report.warnings)
