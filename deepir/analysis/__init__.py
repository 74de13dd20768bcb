"""How much jitter, how many frames: the statistics of a camera's pattern, and what a burst makes of them."""

from deepir.analysis.statistics import Statistics, of_flat, of_map
from deepir.analysis.verdict import Verdict, judge

__all__ = ["Statistics", "Verdict", "judge", "of_flat", "of_map"]
