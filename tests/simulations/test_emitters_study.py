"""The studies of emitters without identity, once in small."""

from simulations import emitters, same_code


def test_the_scenes_in_small(capsys):
    emitters.main(["--runs", "1", "--steps", "8", "--scenes", "known,toa"])
    rows = [row.split() for row in capsys.readouterr().out.splitlines()[2:]]
    assert [row[:2] for row in rows] == [["known", "static"], ["toa", "static"], ["toa", "fed"]]
    assert rows[1][2] == rows[2][2]  # scans by themselves are the same
    assert all(0 < float(row[3]) <= (4 * 200.0**2) ** 0.5 + 200 for row in rows)


def test_one_code_in_small(capsys):
    same_code.main(["--runs", "1", "--hours", "0.8", "--method", "points"])
    out = capsys.readouterr().out
    assert "two transmitters found in 100 %" in out and "one transmitter split in 0 %" in out
    error = float(out.split("mean error ")[1].split(" m")[0])
    assert 0 < error < 30
