"""Panel 1 of Hostetter & Royle (2020) in JAGS beside maloc: ``python -m benchmarks.jags``.

The known-interval model on one simulated data set, the same for both. Effective draws (bulk) of
p0, sigma_det and sigma_u are counted per CPU second after adaptation and burn-in; the ratio is that
of the worst of the three. JAGS is the plain program ``jags`` (Debian: ``apt-get install jags``); R
is not needed. Without it the benchmark says so and gives maloc's numbers alone.

The default is small: 8 tags, 150 burnt and 400 kept iterations of two chains, six minutes. The
figure to report comes from the whole data set and longer chains, about an hour and a half:
``python -m benchmarks.jags --tags 25 --burn 500 --keep 2000``. (The paper kept 15 000.)
"""

from __future__ import annotations

import benchmarks._threads  # noqa: F401  isort: skip

import argparse
import re
import resource
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

import maloc
from maloc._jax import jax
from maloc.data import EncounterHistory
from maloc.infer._diagnostics import ess_bulk
from maloc.simulate.hostetter_royle import Design, simulate_study

NAMES = {"p0": "p0", "sigma.det": "scale", "sigma.u": "sigma_step"}  # JAGS -> maloc
MISSING = "jags is not on the path (Debian: apt-get install jags): maloc alone"

# Panel 1 with tags laid end to end: first[k] and last[k] are tag k's rows.
PANEL_1 = """model {
  p0 ~ dunif(0, 1)
  sigma.det ~ dunif(0, 10)
  sigma.u ~ dunif(0, 10)
  for (k in 1:N) {
    u[first[k], 1] ~ dunif(xlim[1], xlim[2])
    u[first[k], 2] ~ dunif(ylim[1], ylim[2])
    for (t in (first[k] + 1):last[k]) {
      tau[t] <- 1 / (dt[t] * sigma.u * sigma.u)
      u[t, 1] ~ dnorm(u[t - 1, 1], tau[t])
      u[t, 2] ~ dnorm(u[t - 1, 2], tau[t])
    }
  }
  for (t in 1:T) {
    for (j in 1:J) {
      d2[j, t] <- pow(u[t, 1] - X[j, 1], 2) + pow(u[t, 2] - X[j, 2], 2)
      y[j, t] ~ dbern(p[j, t])
      p[j, t] <- p0 * exp(-d2[j, t] / (2 * sigma.det * sigma.det))
    }
  }
}
"""


class Speed(NamedTuple):
    """Posterior mean and effective draws of each parameter, and CPU seconds of the kept draws."""

    mean: dict[str, float]
    ess: dict[str, float]
    cpu: float

    @property
    def worst(self) -> float:
        """Effective draws a CPU second of the slowest parameter."""
        return min(self.ess.values()) / self.cpu


def _dump(name: str, value: np.ndarray) -> str:
    """One variable in R's dump format, as JAGS reads it."""
    flat = ", ".join(f"{v:.10g}" for v in np.ravel(value, order="F"))
    if np.ndim(value) == 0:
        return f"{name} <- {value:.10g}\n"
    if np.ndim(value) == 1:
        return f"{name} <- c({flat})\n"
    shape = ", ".join(map(str, np.shape(value)))
    return f"{name} <- structure(c({flat}), .Dim = c({shape}))\n"


def jags_data(history: EncounterHistory) -> str:
    """Data of the model in R's dump format."""
    step = np.diff(history.time, prepend=history.time[0])
    step[history.first_rows] = 1.0  # not used
    parts = {
        "N": np.asarray(len(history.tags)),
        "T": np.asarray(len(history)),
        "J": np.asarray(len(history.receivers)),
        "first": history.first_rows + 1,
        "last": history.last_rows + 1,
        "dt": step,
        "X": history.receivers.xy,
        "xlim": np.array([history.low[0], history.high[0]]),
        "ylim": np.array([history.low[1], history.high[1]]),
        "y": history.heard.T.astype(int),
    }
    return "".join(_dump(name, value) for name, value in parts.items())


def jags_start(history: EncounterHistory, seed: int) -> str:
    """Start: middles of the receivers that heard, and sizes near the simulation's."""
    from maloc.model_data.states import middles

    rng = np.random.default_rng(seed)
    noisy = middles(history) + rng.normal(0, 0.05, (len(history), 2))
    values = {
        "p0": np.asarray(rng.uniform(0.4, 0.7)),
        "sigma.det": np.asarray(rng.uniform(0.6, 0.9)),
        "sigma.u": np.asarray(rng.uniform(0.2, 0.4)),
        "u": np.clip(noisy, history.low + 0.01, history.high - 0.01),
        ".RNG.seed": np.asarray(seed + 1),
    }
    rng_name = '".RNG.name" <- "base::Mersenne-Twister"\n'
    return rng_name + "".join(_dump(f'"{name}"', v) for name, v in values.items())


def _script(adapt: int, burn: int, keep: int) -> str:
    lines = ["model in panel1.txt", "data in data.txt", "compile, nchains(1)"]
    lines += ["parameters in start.txt", "initialize", f"adapt {adapt}"]
    if burn:
        lines.append(f"update {burn}")
    if keep:
        lines += [f"monitor {name}" for name in NAMES]
        lines += [f"update {keep}", "coda *"]
    return "\n".join([*lines, "exit", ""])


def _run(folder: Path, script: str) -> float:
    """Run a script; the program's user CPU seconds."""
    (folder / "run.cmd").write_text(script)
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    done = subprocess.run(
        ["jags", "run.cmd"], cwd=folder, capture_output=True, text=True, check=False
    )
    said = done.stdout + done.stderr
    if done.returncode or re.search(r"error|fail", said, re.IGNORECASE):
        raise RuntimeError(f"jags: {said[-400:]}")
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before


def read_coda(folder: Path) -> dict[str, np.ndarray]:
    """Draws by parameter from CODAindex.txt and CODAchain1.txt."""
    draws = np.loadtxt(folder / "CODAchain1.txt")[:, 1]
    found = {}
    for line in (folder / "CODAindex.txt").read_text().splitlines():
        name, start, end = line.split()
        found[name] = draws[int(start) - 1 : int(end)]
    return found


def jags(history: EncounterHistory, adapt: int, burn: int, keep: int, chains: int = 2) -> Speed:
    """Chains one after the other; what they take to come to the kept draws is timed apart."""
    found, spent = [], 0.0
    for chain in range(chains):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            (folder / "panel1.txt").write_text(PANEL_1)
            (folder / "data.txt").write_text(jags_data(history))
            (folder / "start.txt").write_text(jags_start(history, chain))
            before = _run(folder, _script(adapt, burn, 0))
            spent += _run(folder, _script(adapt, burn, keep)) - before
            found.append(read_coda(folder))
    draws = {new: np.stack([f[old] for f in found]) for old, new in NAMES.items()}
    return _speed(draws, spent)


def _speed(draws: dict[str, np.ndarray], cpu: float) -> Speed:
    ess = {name: float(ess_bulk(v[..., None])[0]) for name, v in draws.items()}
    return Speed({name: float(v.mean()) for name, v in draws.items()}, ess, cpu)


def ours(history: EncounterHistory, method: str, draws: int, seed: int = 0) -> Speed:
    """Sampler of maloc, two chains."""
    fit = maloc.infer.nuts(
        jax.random.key(seed),
        maloc.models.known_interval,
        history,
        method=method,
        draws=draws,
        progress=False,
    )
    found = fit.draws()
    return _speed({n: found[n] for n in NAMES.values()}, float(np.sum(fit.stats["cpu"])))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tags", type=int, default=8)
    parser.add_argument("--side", type=int, default=10, help="receivers along a side")
    parser.add_argument("--duration", type=float, default=150.0)
    parser.add_argument("--adapt", type=int, default=100)
    parser.add_argument("--burn", type=int, default=150)
    parser.add_argument("--keep", type=int, default=400)
    parser.add_argument("--draws", type=int, default=500, help="of each of maloc's two chains")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    design = Design(tags=given.tags, side=given.side, duration=given.duration)
    study = simulate_study(np.random.default_rng([given.seed, 0]), design)
    history = study.history("known_interval")
    print(f"{history!r}\n{'':12}" + "".join(f"{n:>22}" for n in NAMES.values()), end="")
    print(f"{'CPU s':>9}{'worst a CPU s':>15}")
    rows = {f"maloc {m}": ours(history, m, given.draws, given.seed) for m in ("hmc", "nuts")}
    if shutil.which("jags") is None:
        print(MISSING)
    else:
        rows["JAGS"] = jags(history, given.adapt, given.burn, given.keep)
    for name, speed in rows.items():
        line = "".join(f"{speed.mean[n]:>12.4f}, ESS {speed.ess[n]:<5.0f}" for n in NAMES.values())
        line = f"{name:12}{line}{speed.cpu:>9.1f}{speed.worst:>15.3f}"
        if "JAGS" in rows and name != "JAGS":
            line += f"   {speed.worst / rows['JAGS'].worst:.0f} x JAGS"
        print(line)


if __name__ == "__main__":
    main()
