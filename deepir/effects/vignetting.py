"""Whether the gain is shaded, as a lens that vignettes does it: by the evidence of what is smooth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch

from deepir.effects.effect import Effect, Rounds
from deepir.effects.shading import doubt, low_order_unknowns
from deepir.estimation.gain_offset_evidence import GainOffsetEvidence, gain_and_offset
from deepir.estimation.line_levels import has_line_noise
from deepir.fields.shading import Shading
from deepir.problem import Problem
from deepir.registry import register
from deepir.schedule import Schedule

ENOUGH = 4  # frames: three tell smooth gains from the scene hardly at all
CERTAIN = 10  # nats by which a shaded gain has to make the frames likelier
STRONG, SURE = 0.08, 150  # strength from which it has to by so many: skies and walkers seem to have some, too
MOST = 0.18  # what seems to be more is something else: a vignetting of 60 % has 0.08 to 0.15


def unknown_gain_shadings(problem: Problem) -> list[Shading]:
    """Those of the gain whose strength is to be found; none where too little is there to find it."""
    offsets, stray, _ = low_order_unknowns(problem)
    if not offsets or stray or len(problem.data) < ENOUGH:
        return []
    parts = gain_and_offset(problem)[0].parts()
    return [part for part in parts if isinstance(part, Shading) and not part.sigma_is_fixed]


def detect_vignetting(problem: Problem) -> bool:
    """Whether it is, as far as the evidence goes; see `estimate_vignetting`."""
    return bool(unknown_gain_shadings(problem)) and _likeliest(problem) is not None


@torch.no_grad()
def estimate_vignetting(problem: Problem) -> None:
    """If the gain is shaded, set the strength of that, and with it those of the offset's shading and of a drift."""
    found, (offsets, _, drifts) = _likeliest(problem), low_order_unknowns(problem)
    if found is None:
        return
    offset, drift, gain = found
    for part in unknown_gain_shadings(problem):
        part.sigma.fill_(gain)
    for part in offsets:  # a gain may stand in for it, but where the scene is even
        part.sigma.fill_(max(offset, float(part.sigma)))
    if not has_line_noise(problem):  # without the means of lines the levels are not seen
        for field in drifts:
            field.sigma.fill_(drift)


@torch.no_grad()
def _likeliest(problem: Problem) -> list[float] | None:
    """The strengths of the offset's shading, a drift and the gain's shading; None if there is none of the gain.

    It has to be likelier where the frames' slow parts may be wrong, too: this is asked last, for it takes longer.
    """
    drift = bool(low_order_unknowns(problem)[2]) and not has_line_noise(problem)
    for of in (None, doubt):
        evidence = GainOffsetEvidence(problem, doubt=of and of(problem))
        even, _ = evidence.best(shaded=False, drift=drift)
        nats, found = evidence.best(shaded=True, drift=drift)
        certain = CERTAIN if found[-1] < STRONG else SURE
        if not (nats + certain < even and found[-1] < MOST):
            return None
    return found


@register("effect", "vignetting")
@dataclass(frozen=True)
class Vignetting(Effect):
    """A gain that falls off towards the edges, as a lens makes it."""

    def plan(self, problem: Problem, schedule: Schedule, rounds: Rounds) -> Schedule:
        if not unknown_gain_shadings(problem):
            return schedule

        def prepare(problem: Problem) -> None:
            rounds.update(problem)
            estimate_vignetting(problem)

        last = schedule("sensor 3")
        return schedule.before(
            "scene", replace(last, name="shaded gain", prepare=prepare, needed=detect_vignetting)
        )
