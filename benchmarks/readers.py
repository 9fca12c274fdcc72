"""How fast exports are read, and in how much memory: ``python -m benchmarks.readers``.

Writes made-up exports into a temporary folder and reads each in a fresh process, which says its
seconds (without imports), wall and CPU, and the most memory that it held.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
import polars as pl

START = 1_622_548_800_000  # ms
_READ = """
import json, resource, sys, time
import maloc.readers._recognise, maloc.data.detections
from maloc.data import read_detections
began, busy = time.perf_counter(), time.process_time()
found = read_detections(sys.argv[1])
seconds, busy = time.perf_counter() - began, time.process_time() - busy
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
print(json.dumps([len(found), len(found.receivers), len(found.tags), seconds, busy, peak]))
"""


def made_up(rows: int, seed: int = 0) -> pl.DataFrame:
    """Return detections of 30 receivers and 60 tags in time order, to the millisecond."""
    rng = np.random.default_rng(seed)
    time = START + np.cumsum(rng.integers(1, 200, rows))
    return pl.DataFrame(
        {
            "time": pl.Series(time).cast(pl.Datetime("ms")),
            "serial": rng.integers(301001, 301031, rows),
            "id": rng.integers(12345, 12405, rows),
        }
    )


def write_vue(table: pl.DataFrame, path: Path) -> None:
    """Write detections as VUE exports them: ten columns, most of them empty."""
    empty = pl.lit(None, pl.String)
    table.select(
        pl.col("time").dt.strftime("%Y-%m-%d %H:%M:%S%.3f").alias("Date and Time (UTC)"),
        pl.format("VR2W-{}", "serial").alias("Receiver"),
        pl.format("A69-1602-{}", "id").alias("Transmitter"),
        *(empty.alias(c) for c in ("Transmitter Name", "Transmitter Serial", "Sensor Value")),
        empty.alias("Sensor Unit"),
        pl.format("ST{}", pl.col("serial") - 301000).alias("Station Name"),
        pl.lit("+0").alias("Latitude"),
        pl.lit("+0").alias("Longitude"),
    ).write_csv(path)


def write_vdat(table: pl.DataFrame, path: Path) -> None:
    """Write detections as Fathom does: one record type of several, times in two columns."""
    head = (
        "\ufeffVEMCO DATA LOG,2.0.0,made-up\n"
        "RECORD TYPE,FIELD,FIELD,FIELD,FIELD,FIELD,FIELD,FIELD\n"
        "DET_DESC,Device Time (UTC),Time,Time Offset (h),Time Correction (s),Model,Serial Number,"
        "Channel,Detection Type,Full ID,ID,Raw Data\n"
    )
    stamp = pl.col("time").dt.strftime("%Y-%m-%d %H:%M:%S%.3f")
    same = {
        "record": "DET", "offset": "0", "correction": "0.000000", "model": "VR2Tx-69",
        "channel": "1", "type": "PPM", "raw": None,
    }  # fmt: skip
    body = table.with_columns(
        stamp.alias("device"),
        (stamp + "0").alias("corrected"),
        pl.format("A69-1602-{}", "id").alias("full"),
        **{name: pl.lit(value, pl.String) for name, value in same.items()},
    ).select(
        *("record", "device", "corrected", "offset", "correction", "model", "serial"),
        *("channel", "type", "full", "id", "raw"),
    )
    path.write_text(head + body.write_csv(include_header=False))


WRITERS = {"vue": write_vue, "vdat": write_vdat}


class Reading(NamedTuple):
    """What reading a file took: wall and CPU seconds (of all threads), most memory held, MB."""

    rows: int
    receivers: int
    tags: int
    seconds: float
    cpu: float
    peak: float


def read_apart(path: Path) -> Reading:
    """Read a file in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-c", _READ, str(path)], check=True, capture_output=True, text=True
    )
    return Reading(*json.loads(done.stdout))


def main() -> None:
    """Print a row a format."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=20_000)
    parser.add_argument("--formats", nargs="+", choices=WRITERS, default=list(WRITERS))
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    table = made_up(given.rows, given.seed)
    print(f"{'format':<8}{'file, MB':>10}{'rows':>10}{'read':>10}", end="")
    print(f"{'seconds':>10}{'CPU, s':>10}{'peak, MB':>10}")
    with tempfile.TemporaryDirectory() as folder:
        for name in given.formats:
            path = Path(folder) / f"{name}.csv"
            WRITERS[name](table, path)
            found = read_apart(path)
            size = path.stat().st_size / 1e6
            print(f"{name:<8}{size:>10.1f}{len(table):>10}{found.rows:>10}", end="")
            print(f"{found.seconds:>10.2f}{found.cpu:>10.2f}{found.peak:>10.0f}")


if __name__ == "__main__":
    main()
