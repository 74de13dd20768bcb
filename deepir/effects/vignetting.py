"""Vignetting: a gain that falls off towards the edges, as a lens makes it; by the evidence of low-order parts."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch

from deepir.effects.effect import Effect, Rounds
from deepir.effects.shading import low_order_doubt, low_order_unknowns
from deepir.estimation.low_order_evidence import GainOffsetEvidence, gain_and_offset
from deepir.estimation.residuals import has_line_noise
from deepir.fields.shading import Shading
from deepir.problem import Problem
from deepir.registry import register
from deepir.schedule import Schedule


@register("effect", "vignetting")
@dataclass(frozen=True)
class Vignetting(Effect):
    """A gain that falls off towards the edges, as a lens makes it.

    Args:
        min_frames: Three frames hardly separate a low-order gain from the scene.
        min_evidence: Nats by which a shaded gain has to make the frames likelier.
        strong_sigma: Standard deviation from which it has to by `strong_evidence`: skies and moving objects look alike.
        strong_evidence: Nats.
        max_sigma: Standard deviation that no lens exceeds: a fall-off of 60 % has 0.08 to 0.15.
        max_truncated: Share of pixels cut off in all frames. Bright places lack their large offsets, as under a gain.
    """

    min_frames: int = 4
    min_evidence: float = 10.0
    strong_sigma: float = 0.08
    strong_evidence: float = 150.0
    max_sigma: float = 0.18
    max_truncated: float = 0.02

    def plan(self, problem: Problem, schedule: Schedule, rounds: Rounds) -> Schedule:
        if not self.unknown(problem):
            return schedule

        def prepare(problem: Problem) -> None:
            rounds.update(problem)
            self.estimate(problem)

        last = schedule("sensor 3")
        return schedule.before(
            "scene", replace(last, name="shaded gain", prepare=prepare, needed=self.is_present)
        )

    def unknown(self, problem: Problem) -> list[Shading]:
        """Shadings of the gain whose standard deviation is to be found; none where too little separates them."""
        offsets, stray, _ = low_order_unknowns(problem)
        if not offsets or stray or len(problem.data) < self.min_frames or self.is_truncated(problem):
            return []
        parts = gain_and_offset(problem)[0].parts()
        return [part for part in parts if isinstance(part, Shading) and not part.sigma_is_fixed]

    def is_truncated(self, problem: Problem) -> bool:
        """Whether the offsets that are seen are a selection."""
        if problem.saturation is None:
            return False
        return float((problem.saturation != 0).all(0).float().mean()) > self.max_truncated

    def is_present(self, problem: Problem) -> bool:
        """Whether the evidence is for a shaded gain."""
        return bool(self.unknown(problem)) and self._most_likely(problem) is not None

    @torch.no_grad()
    def estimate(self, problem: Problem) -> None:
        """Set the standard deviations of the gain's shading, the offset's and the drift, if the gain is shaded."""
        found, (offsets, _, drifts) = self._most_likely(problem), low_order_unknowns(problem)
        if found is None:
            return
        offset, drift, gain = found
        for part in self.unknown(problem):
            part.sigma.fill_(gain)
        for part in offsets:  # a gain stands in for it, unless the scene is flat
            part.sigma.fill_(max(offset, float(part.sigma)))
        if not has_line_noise(problem):  # without the means of lines the levels are not seen
            for field in drifts:
                field.sigma.fill_(drift)

    @torch.no_grad()
    def _most_likely(self, problem: Problem) -> list[float] | None:
        """Standard deviations of the offset's shading, a drift and the gain's shading; None if the gain has none.

        It has to be likelier, too, where the low-order parts of the frames are doubted.
        """
        drift = bool(low_order_unknowns(problem)[2]) and not has_line_noise(problem)
        for doubted in (False, True):
            evidence = GainOffsetEvidence(problem, doubt=low_order_doubt(problem) if doubted else None)
            even, _ = evidence.best(shaded=False, drift=drift)
            nats, found = evidence.best(shaded=True, drift=drift)
            margin = self.min_evidence if found[-1] < self.strong_sigma else self.strong_evidence
            if not (nats + margin < even and found[-1] < self.max_sigma):
                return None
        return found
