"""Jitter and number of frames: statistics of a pattern, and how well a burst separates it from the scene."""

from deepir.analysis.burst_assessment import (
    BurstAssessment,
    PatternStatistics,
    assess_burst,
    flat_statistics,
    map_statistics,
)

__all__ = ["BurstAssessment", "PatternStatistics", "assess_burst", "flat_statistics", "map_statistics"]
