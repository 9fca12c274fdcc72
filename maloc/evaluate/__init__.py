"""Score a track against the truth: any two tables, maloc's, YAPS's, a VPS's or a GPS's.

Comes in: tables of tracks and truth, whoever wrote them (`tables.py`); arrival times, to be
    tracked by halves of the receivers where there is no truth.
Goes out: an `Evaluation`, a `Halves`.
Start reading: `score.py`; what a ping and a track are judged by is in `scores.py`. Without truth:
    `halves.py`, and `offsets.py` for receivers that are late on the whole.
The page: docs/classical.md, "Scores of any track"; docs/checks.md, "Halves of the receivers".
"""

from maloc.evaluate.halves import (
    Halves,
    compare_halves,
    every_other,
    half_of,
    halves,
    named_half,
    random_half,
)
from maloc.evaluate.offsets import receiver_offsets
from maloc.evaluate.score import Evaluation, evaluate, true_positions

__all__ = [
    "Evaluation",
    "Halves",
    "compare_halves",
    "evaluate",
    "every_other",
    "half_of",
    "halves",
    "named_half",
    "random_half",
    "receiver_offsets",
    "true_positions",
]
