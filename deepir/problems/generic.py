"""A problem that is a YAML file only."""

from __future__ import annotations

from deepir.joint_problem import AnyProblem
from deepir.problems.recipe import Recipe
from deepir.registry import register


@register("problem", "generic")
class Generic(Recipe):
    """Any operator and any unknowns: all are estimated together; gain and offset in closed form where they have one."""

    several = True
    effect_names = (
        "saturation",
        "bad_pixels",
        "frame_gain",
        "frame_offset",
        "noise",
        "sensor_pattern",
        "shading",
        "outliers",
    )

    def initialise(self, problem: AnyProblem, seed: int) -> None:
        """All samples are fitted."""
        self.start(problem)
