"""Score a track against the truth: any two tables, maloc's, YAPS's, a VPS's or a GPS's.

Comes in: tables of tracks and truth, whoever wrote them (`tables.py`).
Goes out: an `Evaluation`.
Start reading: `score.py`; what a ping and a track are judged by is in `scores.py`.
The page: docs/classical.md, "Scores of any track".
"""

from maloc.evaluate.score import Evaluation, evaluate, true_positions

__all__ = ["Evaluation", "evaluate", "true_positions"]
