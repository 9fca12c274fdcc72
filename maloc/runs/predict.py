"""What `maloc predict` does, from a finished run to a folder of its own."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from maloc.errors import InputError
from maloc.export.folder import check_free, output_folder
from maloc.runs.log import Log

if TYPE_CHECKING:
    import polars as pl

    from maloc.infer.predict import TrackDraws

__all__ = ["draws_table", "run_predict"]


def run_predict(
    run: Path,
    out: Path,
    every: float,
    *,
    around: tuple[float, float] = (0.0, 0.0),
    draws: int = 100,
    seed: int = 0,
    force: bool = False,
    quiet: bool = False,
) -> list[str]:
    """Do all of `maloc predict`; nothing is written unless everything worked.

    Parameters
    ----------
    run : Path
        Folder of a `maloc track`.
    out : Path
        Folder to write.
    every : float
        Seconds from one time to the next.
    around : pair of float
        How long before the first ping and after the last, s.
    draws : int
        Whole tracks to write; 0 for none.

    Returns
    -------
    list of str
        One line a tag.

    Raises
    ------
    InputError
        Bad input, or `out` is taken.
    """
    check_free(out, force)
    if min(around) < 0:
        raise InputError("--before and --after are seconds, 0 or more")
    log = Log(quiet)
    with log.listening():
        import numpy as np
        import polars as pl
        from tqdm import tqdm

        from maloc.export import output
        from maloc.predict import prediction_table, read_tracks, regular_times

        with log.stage("read"):
            tracks = read_tracks(run)
        log.release()
        tables, whole, lines = [], [], []
        with log.stage("predict"):
            for track in tqdm(tracks, "predict", disable=quiet or len(tracks) < 2, leave=False):
                first, last = track.span
                times = regular_times(first - around[0], last + around[1], every, track.origin)
                if not len(times):
                    log.warn(f"tag {track.tag}: no multiple of {every:g} s within its track")
                    continue
                tables.append(prediction_table(track, times, seed))
                if draws:
                    whole.append(draws_table(track.sample_tracks(times, draws, seed)))
                sd = np.median(tables[-1].select("sd_x", "sd_y").to_numpy())
                lines.append(f"{track.tag or 'track'}: {len(times)} times, median sd {sd:.3g} m")
        if not tables:
            raise InputError(
                f"no multiple of {every:g} s within any track", mend="a smaller --every"
            )
        with output_folder(out, force) as folder:
            with log.stage("write"):
                table = pl.concat(tables, how="diagonal_relaxed")
                output.write_table(table, folder / "predicted.csv")
                if whole:
                    pl.concat(whole, how="diagonal_relaxed").write_parquet(folder / "draws.parquet")
            options = {"run": str(run), "every": every, "before": around[0], "after": around[1]}
            summary = {
                "command": "predict",
                "versions": output.versions(),
                "seed": seed,
                "options": options | {"draws": draws},
                "crs": tracks[0].crs,
                "tags": {t.tag or "track": {"method": t.method, "span": t.span} for t in tracks},
                "warnings": log.warnings,
                "notices": log.notices,
                "seconds": log.seconds,
            }
            output.write_json(summary, folder / "summary.json")
    return lines


def draws_table(tracks: TrackDraws) -> pl.DataFrame:
    """Whole tracks as a table, one row a draw and time.

    Returns
    -------
    polars.DataFrame
        tag, draw (from 1), time (UTC, null where there is no date), t (s), x, y (m), depth z (m)
        of a track that has it and, where the movement has velocities, vx, vy (m/s).
    """
    import numpy as np
    import polars as pl

    draws, n = tracks.position.shape[:2]
    shift = 0 if tracks.origin is None else tracks.origin
    time = pl.Series(shift + np.round(tracks.times * 1e9).astype(np.int64)).cast(
        pl.Datetime("ns", "UTC")
    )
    if tracks.origin is None:
        time = pl.Series([None] * n, dtype=pl.Datetime("ns", "UTC"))
    columns = {
        "tag": pl.Series([tracks.tag]).new_from_index(0, draws * n),
        "draw": np.repeat(np.arange(1, draws + 1), n),
        "time": pl.concat([time] * draws),
        "t": np.tile(shift / 1e9 + tracks.times, draws),
        "x": tracks.position[..., 0].ravel(),
        "y": tracks.position[..., 1].ravel(),
    }
    if tracks.depth is not None:
        columns["z"] = tracks.depth.ravel()
    if tracks.velocity is not None:
        columns |= {"vx": tracks.velocity[..., 0].ravel(), "vy": tracks.velocity[..., 1].ravel()}
    return pl.DataFrame(columns)
