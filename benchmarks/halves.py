"""Tracks by halves of the receivers against one another: ``python -m benchmarks.halves DATA``.

DATA holds the data sets scirep (every other hydrophone, the first 500 pings, the sound speed
estimated) and ssu1 (every other receiver of the table, one synchronisation). A row a data set, over
the pings heard by ``--least`` receivers of both halves: the mean squared difference over the summed
variances by axis, shares within 1.96 standard deviations, median and worst distance (m), what is
asked; then the receivers whose direct arrivals are late or early on the whole.
"""

from __future__ import annotations

import benchmarks._threads  # noqa: F401  isort: skip

import argparse
import time
from dataclasses import replace
from pathlib import Path

from benchmarks._worlds import scirep_toa, ssu1_options
from maloc import ArrivalTimes
from maloc.runs.halves import HalvesOptions, halves_of_tag, score_lines
from maloc.runs.load import load
from maloc.runs.log import Log
from maloc.runs.options import TrackOptions

ASKED = {
    "scirep": "chi2 <= 1.5, within >= .90",
    "ssu1": "no worse than chi2 .76, .37, within .99, 1.00",
}


def data_set(name: str, data: Path, pings: int) -> tuple[ArrivalTimes, TrackOptions]:
    """Arrival times of a data set on one clock, and how its tag is tracked."""
    if name == "scirep":
        options = TrackOptions(toa=data / "scirep" / "toa.csv", sound_speed="estimated")
        return scirep_toa(data, pings), options
    options = ssu1_options(data)
    (toa,) = load(options, Log(quiet=True)).toas
    return toa, options


def main(argv: list[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path, help="folder of the data sets")
    parser.add_argument("--sets", default="scirep,ssu1", help="which: scirep,ssu1")
    parser.add_argument("--pings", type=int, default=500, help="of scirep")
    parser.add_argument("--split", default="alternate", help="as of maloc halves")
    parser.add_argument("--least", type=int, default=4)
    parser.add_argument("--seed", type=int, default=0, help="of --split random")
    given = parser.parse_args(argv)
    for name in given.sets.split(","):
        if name not in ASKED:
            parser.error(f"no data set {name}: {', '.join(ASKED)}")
        log, begin = Log(quiet=True), time.process_time()
        toa, source = data_set(name, given.data, given.pings)
        options = HalvesOptions(replace(source, seed=given.seed), given.split, given.least)
        with log.listening():
            found = halves_of_tag(toa, options.first(toa.receivers), options, log)
        head, row, *named = score_lines([found._replace(tag=name)])
        print(f"{head}  asked\n{row}  {ASKED[name]}")
        for text in [*named, *(f"warned: {w}" for w in log.warnings)]:
            print(f"  {text}")
        print(f"  {time.process_time() - begin:.0f} CPU s, compiling and reading too\n", flush=True)


if __name__ == "__main__":
    main()
