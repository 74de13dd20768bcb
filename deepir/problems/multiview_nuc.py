"""Non-uniformity correction of frames of different scenes."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from deepir.errors import ConfigError
from deepir.noise import flat_noise
from deepir.priors.field import Field
from deepir.priors.parts import Part
from deepir.problem import Problem
from deepir.problems.definition import Definition, start_scene
from deepir.registry import register
from deepir.solve import Stage, Step
from deepir.strengths import weigh_scene
from deepir.unregistered import find_pattern


@register("problem", "multiview_nuc")
class MultiviewNUC(Definition):
    """The scene of each frame, and the gain and offset that all frames share; nothing is registered.

    (The setting of Barral, Arias and Davy 2024, "Fixed pattern noise removal for multi-view single-sensor infrared
    camera".) The sensor is found from the gradients of all frames together, then each scene with the sensor fixed.
    """

    frames = 2
    operators = ("sensor",)

    def initialise(self, problem: Problem, seed: int) -> None:
        """The sensor, from the frames alone, the noise that it leaves, and the scenes as they then look."""
        frames, usable = problem.data[:, 0], problem.precision[:, 0] > 0
        gain, offset = (_parts(problem, slot) for slot in ("gain", "offset"))
        find_pattern(frames, usable, gain, offset)
        if not problem.known_noise:
            noise = flat_noise(_corrected(problem), usable)
            problem.precision.copy_(usable[:, None] / max(noise, 1e-4 * float(frames[usable].std())) ** 2)
        start_scene(problem)
        weigh_scene(problem)

    def plan(self, problem: Problem) -> list[Stage]:
        """The scenes, with the sensor fixed.

        Raises:
            ConfigError: All frames share a scene, or gain and offset are no sums of parts.
        """
        if problem.fields["scene"].shape[0] < len(problem.data):
            raise ConfigError(
                "scene.shared: 'multiview_nuc' is for frames of different scenes, scene.shared=false; "
                "frames of one scene are for 'nuc'"
            )
        for slot in ("gain", "offset"):
            _parts(problem, slot)
        return [Stage("scene", (Step(("scene",)),), 40)]


def _parts(problem: Problem, slot: str) -> Sequence[Part]:
    """The parts of the sensor's gain or offset; none if it is known."""
    name = f"{problem.operator.named()[-1][0]}.{slot}"
    field: Field = problem.fields[problem.slots[name]]
    if problem.slots[name] not in problem.free():
        return ()
    if not field.parts():
        raise ConfigError(
            f"physics.{name}: 'multiview_nuc' finds sums of column, row, pixel and, in the offset, shading"
        )
    return field.parts()


def _corrected(problem: Problem) -> torch.Tensor:
    """The frames without the sensor's pattern, (N, h, w)."""
    values, stage = problem.values(()), problem.operator.named()[-1][0]
    gain, offset = (values[problem.slots[f"{stage}.{slot}"]] for slot in ("gain", "offset"))
    return ((problem.data - offset) / gain)[:, 0]
