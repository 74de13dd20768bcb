"""Samples far from what the model expects."""

from __future__ import annotations

from dataclasses import dataclass

from deepir.effects.effect import Effect, InitialEstimate
from deepir.estimation.residuals import down_weight_outliers
from deepir.registry import register


@register("effect", "outliers")
@dataclass(frozen=True)
class Outliers(Effect):
    """Down-weights samples with large residuals in the initial estimate (Cauchy weights)."""

    def reject(self, estimate: InitialEstimate) -> None:
        # Gains of frames are found by least squares, not by outliers: weights come before them only in pictures.
        if estimate.step > 0 or estimate.problem.agc:
            down_weight_outliers(estimate.problem, estimate.residual)
