#!/usr/bin/env bash
# ArviZ 1.3 prints an interval of positions that does not hold the mean.
#
# Guess: `az.summary` shows an easting's mean and interval to like digits, as 0.23 does.
# What happens: the printed table (also by `to_string`) rounds interval bounds to two significant
# digits and means by their Monte Carlo error: easting 512 346, interval 510000 to 510000, width 0;
# latitude 44.5123, interval 45 to 45. The numbers inside the frame are whole: `.to_csv()` and
# `.loc` give them, and `round_to=2` prints them.
# Versions: arviz 1.3.0 (arviz-stats 1.3.3) on Python 3.12 or newer. Seen on 30 November 2026.
# Who is hurt: positions in UTM metres or degrees are large numbers with small spread; a table
# pasted into a report states bounds kilometres (or half a degree) away.
set -euo pipefail
python=${PYTHON:-python3}
if ! "$python" -c 'import sys; sys.exit(sys.version_info < (3, 12))' 2>/dev/null; then
    echo "not run: needs Python 3.12 or newer; name one in PYTHON" >&2
    exit 77
fi
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"$python" -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
    arviz==1.3.0 arviz-base==1.3.1 arviz-stats==1.3.3 arviz-plots==1.3.2 numpy==2.5.5 \
    scipy==1.18.1 pandas==3.1.1 xarray==2026.9.0
cd "$folder"
venv/bin/python - <<'EOF'
import arviz as az
import numpy as np

noise = np.random.default_rng(0).normal(size=(4, 500))
posterior = {"easting": 512_345.6 + 3 * noise, "latitude": 44.512345 + 2e-5 * noise}
table = az.summary(az.from_dict({"posterior": posterior}))
print(table.to_string())
shown = [line.split() for line in table.to_string().splitlines()]
column = {name: i + 1 for i, name in enumerate(shown[0])}
lower, upper = column["eti89_lb"], column["eti89_ub"]
rows = {line[0]: line for line in shown[1:]}
assert (rows["easting"][lower], rows["easting"][upper]) == ("510000", "510000")
assert (rows["latitude"][lower], rows["latitude"][upper]) == ("45", "45")
assert float(rows["easting"][column["mean"]]) == 512_346
held = table.loc["easting"]
print("held:", held["eti89_lb"], held["mean"], held["eti89_ub"])
assert 512_340 < held["eti89_lb"] < held["mean"] < held["eti89_ub"] < 512_351
EOF
