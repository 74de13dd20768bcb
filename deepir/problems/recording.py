"""One sensor from several bursts of a recording."""

from __future__ import annotations

from typing import ClassVar

from deepir.problems.nuc import NUC
from deepir.registry import register


@register("problem", "recording")
class Recording(NUC):
    """Gain and offset from several bursts of a recording; a scene, a motion and levels for each of them.

    The rounds are those of `nuc`; the bursts are its data sets, see `deepir.joint_problem`.
    """

    several = True
    checked_frames = 8
    effect_names: ClassVar[tuple[str, ...]] = tuple(
        name for name in NUC.effect_names if name not in ("line_noise", "gain_drift", "vignetting")
    )
