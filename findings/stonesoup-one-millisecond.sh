#!/usr/bin/env bash
# A track half a metre off the truth scores the worst OSPA if its times are a millisecond off.
#
# Guess: Stone Soup's OSPA compares track and truth at common times, or interpolates.
# What happens: it groups states by exact time stamp. A track with the truth's times scores .5 m;
# with all times later by 1 ms there are twice as many times, each with a missed animal or a false
# track, and all of them score the cutoff, here 10 m. No warning.
# Versions: stonesoup 1.9.1. Seen on 30 November 2026.
# Who is hurt: positions from arrival times carry times with fractions, a reference by GPS or video
# has its own; the comparison that is to rank methods ranks their clocks.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
    numpy==2.4.6 scipy==1.17.1 stonesoup==1.9.1
cd "$folder"
venv/bin/python - <<'EOF'
import warnings
from datetime import datetime, timedelta

from stonesoup.measures import Euclidean
from stonesoup.metricgenerator.manager import MultiManager
from stonesoup.metricgenerator.ospametric import OSPAMetric
from stonesoup.types.groundtruth import GroundTruthPath, GroundTruthState
from stonesoup.types.state import State
from stonesoup.types.track import Track

start = datetime(2026, 3, 1, 12)
times = [start + timedelta(seconds=10 * i) for i in range(5)]
truth = GroundTruthPath(
    [GroundTruthState([[float(i)], [0.0]], timestamp=t) for i, t in enumerate(times)]
)
scores = {}
for late in (0, 1):
    moved = [t + timedelta(milliseconds=late) for t in times]
    track = Track([State([[float(i)], [0.5]], timestamp=t) for i, t in enumerate(moved)])
    metric = OSPAMetric(c=10, p=1, measure=Euclidean(), generator_name="ospa",
                        tracks_key="tracks", truths_key="truths")
    manager = MultiManager([metric])
    manager.add_data({"tracks": {track}, "truths": {truth}}, overwrite=False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = manager.generate_metrics()["ospa"]["OSPA distances"].value
    scores[late] = [float(m.value) for m in found]
    print(f"track {late} ms late: OSPA at {len(found)} times, all {set(scores[late])} m")
assert scores == {0: [0.5] * 5, 1: [10.0] * 10}
EOF
