"""Shading of offset and gain, and drift of the level, by the evidence of low-order parts of the frames."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import torch

from deepir.effects.effect import Effect, Rounds
from deepir.estimation.low_order_evidence import GainOffsetEvidence, LowOrderEvidence, contrast
from deepir.estimation.residuals import has_line_noise
from deepir.fields.basis_expansion import BasisExpansion
from deepir.fields.drift import Drift
from deepir.fields.shading import Shading
from deepir.messages import Message
from deepir.operators import Add, Sensor
from deepir.problem import Problem
from deepir.registry import register
from deepir.schedule import Schedule

MIN_FRAMES = 3  # that separate shading and stray flux from the scene


@torch.no_grad()
def estimate_low_order(problem: Problem, *, start: bool = False) -> None:
    """Set the standard deviations of shading and drift by their evidence; with `start` levels and scene, too.

    Stray flux is shading of another shape: it is there if shading is, as strong as it was estimated.
    """
    shadings, stray, drifts = low_order_unknowns(problem)
    if not (shadings or stray or drifts):
        return
    evidence = LowOrderEvidence(problem, stray)
    # Strong stray flux, before anything is known of it, leaves residuals that look like a drift.
    sure = not (start and stray)
    smooth, drift = evidence.most_likely(smooth=bool(shadings or stray), drift=bool(drifts) and sure)
    if smooth and len(problem.data) < MIN_FRAMES:  # a drift is not separated from it either
        smooth = drift = 0.0
    step = contrast(problem) / problem.data[0].numel() ** 0.5 if start else None
    for part in shadings:
        part.sigma.fill_(smooth)
    for field in drifts:
        field.sigma.fill_(drift)
        if step is not None:
            field.preconditioning_scale.copy_(step)
            field.init_from(field.level_offsets + evidence.levels(smooth, drift))
    for each in stray:
        if not each.sigma_is_fixed:
            known = bool(smooth) and bool(each.sigma > 0)
            each.sigma.fill_(float(each.coefficients.square().mean().sqrt()) if known else smooth)
        if step is not None:
            each.preconditioning_scale.copy_(step)
            each.init_from(evidence.low_order_pattern(smooth, drift))
    if start and (smooth or drift):
        scene = problem.fields["scene"]
        scene.init_from(scene() + evidence.low_order_scene(smooth, drift).to(problem.data))


@torch.no_grad()
def estimate_shared_shading(data_sets: Sequence[Problem]) -> None:
    """Set the standard deviations of one sensor's shading, by the evidence of all data sets, and of their drifts."""
    unknowns = {each: low_order_unknowns(each) for each in data_sets if len(each.data) >= MIN_FRAMES}
    shadings = [part for parts, _, _ in unknowns.values() for part in parts]
    if not shadings:
        for each in data_sets:
            estimate_low_order(each)
        return
    evidence = {each: LowOrderEvidence(each) for each in unknowns}
    strength = max(each.contrast for each in evidence.values()) * torch.logspace(-4.5, 0.5, 41, dtype=torch.float64)
    strength = torch.cat((strength.new_zeros(1), strength))
    profiles = {each: one.profile(strength, drift=bool(unknowns[each][2])) for each, one in evidence.items()}
    asked = max(one.min_log_bayes_factor for one in evidence.values()) * (strength > 0)
    best = int((sum(nats for nats, _ in profiles.values()) + asked).argmin())
    for part in shadings:
        part.sigma.fill_(float(strength[best]))
    for each, (_, drifts) in profiles.items():
        for field in unknowns[each][2]:
            field.sigma.fill_(float(drifts[best]))


def low_order_unknowns(problem: Problem) -> tuple[list[Shading], list[BasisExpansion], list[Drift]]:
    """Shadings of the offset and drifts whose strengths are to be found, and stray flux; none without a warp."""
    first, *others = (stage for _, stage in problem.operator.named())
    if not (first.moves and all(stage.keeps_grid for stage in others)) or len(problem.data) < 2:
        return [], [], []
    closed, free = problem.closed_form(), problem.free()
    offset = problem.sensor_unknowns().get("offset", "")
    parts = problem.fields[offset].parts() if offset in closed else ()
    fields = [module for name in free for module in problem.fields[name].modules()]
    return (
        [part for part in parts if isinstance(part, Shading) and not part.sigma_is_fixed],
        stray_flux_fields(problem),
        [field for field in fields if isinstance(field, Drift) and not field.sigma_is_fixed],
    )


def added_flux(problem: Problem) -> list[str]:
    """The unknowns that are added to the scene's flux in front of the sensor."""
    *before, (_, last) = problem.operator.named()
    added = {name for name, stage in before if isinstance(stage, Add) and isinstance(last, Sensor)}
    return [unknown for slot, unknown in problem.slots.items() if slot.rpartition(".")[0] in added]


def stray_flux_fields(problem: Problem) -> list[BasisExpansion]:
    """Free basis expansions that model stray flux."""
    free = problem.free()
    fields = [problem.fields[name] for name in added_flux(problem) if name in free]
    return [field for field in fields if isinstance(field, BasisExpansion)]


@register("effect", "shading")
@dataclass(frozen=True)
class LowOrderParts(Effect):
    """Shading of the offset, stray flux and drift of the level: whether there are any, and how strong they are."""

    of_sensor = True

    def initialise(self, problem: Problem) -> None:
        estimate_low_order(problem, start=True)

    def update(self, problem: Problem, *, settled: bool) -> bool:
        if problem.same_sensor:
            estimate_shared_shading((problem, *problem.same_sensor))
        else:
            estimate_low_order(problem)
        return False

    @torch.no_grad()
    def messages(self, problem: Problem, *, complete: bool) -> Iterator[str]:
        shadings, stray, drifts = low_order_unknowns(problem)
        if not complete or not (shadings or stray) or len(problem.data) >= MIN_FRAMES:
            return
        smooth, _ = LowOrderEvidence(problem, stray).most_likely(smooth=True, drift=bool(drifts))
        if smooth:
            yield Message(
                "shading-not-separated",
                f"the frames are shaded, which {len(problem.data)} of them do not separate from the scene: it is left "
                f"in. Take {MIN_FRAMES} or more",
            )


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

        def needed(problem: Problem) -> bool:
            return bool(self.unknown(problem)) and self._most_likely(problem) is not None

        last = schedule("sensor 3")
        return schedule.before("scene", replace(last, name="shaded gain", prepare=prepare, needed=needed))

    def unknown(self, problem: Problem) -> list[Shading]:
        """Shadings of the gain whose standard deviation is to be found; none where too little separates them."""
        offsets, stray, _ = low_order_unknowns(problem)
        cut = problem.saturation
        if not offsets or stray or len(problem.data) < self.min_frames:
            return []
        if cut is not None and float((cut != 0).all(0).float().mean()) > self.max_truncated:
            return []  # the offsets that are seen are a selection
        parts = problem.fields[problem.gain_and_offset()[0]].parts()
        return [part for part in parts if isinstance(part, Shading) and not part.sigma_is_fixed]

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
            doubt = LowOrderEvidence(problem, stray_flux_fields(problem)).doubt if doubted else None
            evidence = GainOffsetEvidence(problem, doubt=doubt)
            even, _ = evidence.best(shaded=False, drift=drift)
            nats, found = evidence.best(shaded=True, drift=drift)
            margin = self.min_evidence if found[-1] < self.strong_sigma else self.strong_evidence
            if not (nats + margin < even and found[-1] < self.max_sigma):
                return None
        return found
