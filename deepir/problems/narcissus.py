"""Stray flux in front of the sensor."""

from __future__ import annotations

from deepir.problems.nuc import NUC
from deepir.registry import register


@register("problem", "narcissus")
class Narcissus(NUC):
    """Scene, stray flux, gain, offset and motion from a jittered burst: the scene moves, the stray flux stays."""

    operators = ("warp", "add", "sensor")
