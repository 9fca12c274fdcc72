"""Score a track against the truth: any two tables, maloc's, YAPS's, a VPS's or a GPS's."""

from maloc.evaluate.score import Evaluation, evaluate, true_positions

__all__ = ["Evaluation", "evaluate", "true_positions"]
