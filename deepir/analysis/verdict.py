"""Whether a burst suffices to tell a pattern from the scene, in words."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from deepir.analysis.statistics import MIN_REPORTED_SHARE, STABILITY_LEVEL, Array, Statistics
from deepir.operators.geometry import MIN_MOTION_SPAN

MIN_LATERAL_MOTION = 1.5  # px across a line; a burst that moves less across it moves along that line only
MIN_INDEPENDENT_LOOKS = 3.0  # independent views of the pattern that a burst needs
UNCERTAIN_PIXEL_RATIO = 1.5  # scene deviation over its median from which a pixel is weakly determined
#: Fewest and most frames; fewer cost over 1 dB, more are seldom worth their time.
RECOMMENDED_FRAMES = (5, 20)
MOTION_POINTS = (-1 / 3, 0.0, 1 / 3)  # coordinates, in sides of the frame, at which the motion is evaluated


@dataclass(frozen=True)
class Verdict:
    """Of a burst: what it lacks; `left`, the share of the pattern's deviation that its registered average keeps."""

    moves: Array  # (places, N, 2): where each frame looks, less where the first does, (x, y) in px
    left: float
    flags: list[str] = field(default_factory=list)

    @property
    def looks(self) -> float:
        """How many independent patterns would leave as much."""
        return 1 / max(self.left, 1e-3) ** 2


def assess(statistics: Statistics, motion: Array) -> Verdict:
    """What a burst with this motion, (N, 3, 3) pull homographies in px of the detector, makes of the pattern.

    Registered and averaged, frames that look at pixels d_k keep, of the pattern's variance,
    `1 / N^2 sum_pq r(d_p - d_q)` (Saragadam et al. 2021, the variance of the estimate), r its autocorrelation.
    """
    height, width = statistics.pattern.shape
    places = np.array([(x * width, y * height, 1) for y in MOTION_POINTS for x in MOTION_POINTS])
    at = np.einsum("nij,pj->pni", motion, places)
    moves = at[..., :2] / at[..., 2:] - places[:, None, :2]
    apart = moves[:, :, None] - moves[:, None]
    left = math.sqrt(max(float(statistics.at(apart).mean()), 0.0))
    verdict = Verdict(moves, left)
    verdict.flags.extend([*_too_little(statistics, moves), *_too_few(verdict, len(motion))])
    return verdict


def _too_little(statistics: Statistics, moves: Array) -> list[str]:
    """The axes along which the burst does not move far enough, and the line along which it moves."""
    spans = np.ptp(moves, axis=1).mean(0)
    found = []
    for axis, across, span, want in zip("xy", "yx", spans, statistics.lengths, strict=True):
        if span < 1:
            lines = "columns" if axis == "x" else "rows"
            found.append(
                f"the burst moves along {across} only ({span:.1f} px along {axis}): "
                f"the {lines}' pattern is the scene's as well"
            )
        elif span < max(want, MIN_MOTION_SPAN):
            found.append(f"the burst moves by {span:.1f} px along {axis}: {_px(want)} are wanted")
    across_it = np.linalg.svd(moves - moves.mean(1, keepdims=True), full_matrices=False)
    beside = np.ptp(np.einsum("pnj,pj->pn", moves, across_it[2][:, -1]), axis=1).mean()
    if not found and moves.shape[1] > 2 and beside < MIN_LATERAL_MOTION:
        found.append(f"the burst moves along one line, slanted, and {beside:.1f} px across it")
    return found


def _too_few(verdict: Verdict, n: int) -> list[str]:
    if n < 3:
        return [f"too few frames: {n}; take {RECOMMENDED_FRAMES[0]} or more"]
    if verdict.looks < min(MIN_INDEPENDENT_LOOKS, 0.9 * n):
        return [
            f"too few frames so close together: {n} are worth {verdict.looks:.1f} independent looks at the pattern"
        ]
    return []


def report_lines(
    statistics: Statistics, verdict: Verdict | None = None, doubt: Array | None = None
) -> list[str]:
    """The answer, in lines: how far, in which directions, how many frames, for how long; and whether this suffices.

    `doubt` (H, W) is the standard deviation of the scene, where it is known.
    """
    x, y = statistics.lengths
    lines = [
        f"pattern: standard deviation {statistics.pattern.std():.3g}; of its variance {_shares(statistics)}",
        f"move the camera between frames by more than {_px(x)} in x and {_px(y)} in y, in both",
    ]
    if max(x, y) == math.inf:
        lines.append(
            "the pattern is alike over as far as it was looked at: no jitter tells it from the scene"
        )
    if statistics.shading > 0.5:
        lines.append(
            "most of it is shading, which jitter tells from the scene in part only: take a flat frame too"
        )
    if statistics.holds is None:
        lines.append(
            "for how long it holds, a burst does not say: give frames of a uniform source, with --flat"
        )
    elif statistics.holds == math.inf and statistics.in_time is not None:
        seen = len(statistics.in_time) - 1
        lines.append(f"the pattern holds for longer than the {seen} frames over which it can be seen")
    else:
        lines.append(
            f"the pattern holds (autocorrelation above {STABILITY_LEVEL}) for {statistics.holds:.0f} frames"
        )
    most = (
        RECOMMENDED_FRAMES[1]
        if statistics.holds is None
        else max(2, int(min(RECOMMENDED_FRAMES[1], statistics.holds)))
    )
    few = "" if most >= RECOMMENDED_FRAMES[0] else ", few for a good burst: raise the frame rate"
    lines.append(f"take {min(RECOMMENDED_FRAMES[0], most)} to {most} frames{few}")
    if verdict is not None:
        n = verdict.moves.shape[1]
        lines.append(
            f"this burst: {n} frames; averaged, they keep {100 * verdict.left:.0f} % of the pattern's deviation "
            f"({100 / n**0.5:.0f} % at best)"
        )
        if doubt is not None:
            weak = 100 * float((doubt > UNCERTAIN_PIXEL_RATIO * np.median(doubt)).mean())
            lines.append(
                f"{weak:.0f} % of the scene's pixels are weakly determined (over {UNCERTAIN_PIXEL_RATIO:g} times the median)"
            )
        lines += verdict.flags or ["this burst suffices"]
    return lines


def _shares(statistics: Statistics) -> str:
    found = {name: getattr(statistics, name) for name in ("shading", "columns", "rows")}
    found["pixels"] = 1 - sum(found.values())
    kept = {name: each for name, each in found.items() if each >= MIN_REPORTED_SHARE}
    return ", ".join(f"{name} {100 * each:.0f} %" for name, each in kept.items())


def _px(value: float) -> str:
    """A motion that is wanted: what registration and interpolation want at least."""
    return "any number of px" if value == math.inf else f"{math.ceil(max(value, MIN_MOTION_SPAN)):.0f} px"
