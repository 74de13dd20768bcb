"""Jitter and number of frames: the statistics of a camera's pattern, and what a burst makes of them."""

from deepir.analysis.statistics import Statistics, flat_statistics, map_statistics
from deepir.analysis.verdict import Verdict, assess

__all__ = ["Statistics", "Verdict", "assess", "flat_statistics", "map_statistics"]
