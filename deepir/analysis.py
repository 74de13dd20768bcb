"""Jitter and number of frames: statistics of a pattern, and how well a burst separates it from the scene."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from deepir.arrays import Array
from deepir.arrays.samples import autocorrelation

#: Autocorrelation at which the correlation length is read; Saragadam et al. 2021.
CORRELATION_LENGTH_LEVEL = 0.1
#: Temporal autocorrelation down to which a pattern is unchanged; Saragadam et al. 2021.
STABILITY_LEVEL = 0.8
MIN_REPORTED_SHARE = 0.05  # share of the pattern's variance from which a component is reported
MIN_MOTION_SPAN = 3.0  # range of the motion along an axis below which lines and scene cannot be separated well, px
MIN_LATERAL_MOTION = 1.5  # px across a line; a burst that moves less across a line moves along that line only
MIN_INDEPENDENT_LOOKS = 3.0  # independent views of the pattern that a burst needs
UNCERTAIN_PIXEL_RATIO = 1.5  # scene deviation over its median from which a pixel is weakly determined
MIN_PHASES = 0.9  # share of the sub-pixel phases that super-resolution needs
RECOMMENDED_FRAMES = (5, 20)  # fewest and most frames; fewer cost over 1 dB, more are seldom worth their time
MOTION_POINTS = (-1 / 3, 0.0, 1 / 3)  # coordinates, in sides of the frame, at which the motion is evaluated


@dataclass(frozen=True)
class PatternStatistics:
    """Statistics of a fixed pattern."""

    pattern: Array  # (h, w), in the data's units, mean zero
    correlation: Array  # (2 L + 1, 2 L + 1), autocorrelation of the pattern without its shading; lag zero in the middle
    lengths: tuple[float, float]  # correlation lengths along x and y, px
    columns: float  # share of the variance that is constant along columns
    rows: float  # share of the variance that is constant along rows
    shading: float  # share of the variance that is a quadratic polynomial
    temporal: Array | None = None  # (K,), autocorrelation from frame to frame; None if the pattern was seen once
    stable_frames: float | None = None  # for which the pattern is unchanged; infinite: it never changes

    def autocorrelation_at(self, shifts: Array) -> Array:
        """Autocorrelation at shifts (..., 2), x and y in px, by the nearest lag."""
        farthest = len(self.correlation) // 2
        x, y = np.moveaxis(np.rint(shifts).astype(int).clip(-farthest, farthest), -1, 0)
        return np.asarray(self.correlation[farthest + y, farthest + x])


def map_statistics(pattern: Array, good: Array | None = None, repeat: Array | None = None) -> PatternStatistics:
    """Statistics of a pattern that was seen once.

    Args:
        pattern: (h, w), in the data's units.
        good: (h, w) bool, usable pixels; None: all.
        repeat: (h, w), the same pattern with independent noise; products with it are free of noise.
    """
    good = np.ones(pattern.shape, bool) if good is None else good
    repeat = pattern if repeat is None else repeat
    rough, other = (np.where(good, each - quadratic_fit(each, good), 0.0) for each in (pattern, repeat))
    level = pattern[good].mean()
    total, without_shading = (
        (a * b)[good].mean() for a, b in ((pattern - level, repeat - repeat[good].mean()), (rough, other))
    )
    correlation = autocorrelation(rough, other, good)
    middle = len(correlation) // 2
    along_x, along_y = correlation[middle, middle:], correlation[middle:, middle]
    rows, columns = plateau(along_x), plateau(along_y)
    lengths = (
        correlation_length((along_x - rows) / (1 - rows)),
        correlation_length((along_y - columns) / (1 - columns)),
    )
    shading = max(0.0, 1 - without_shading / total) if total > 0 else 0.0
    return PatternStatistics(
        np.where(good, pattern - level, 0), correlation, lengths, columns * (1 - shading), rows * (1 - shading), shading
    )


def flat_statistics(frames: Array, good: Array | None = None) -> PatternStatistics:
    """Statistics of successive frames of a uniform source.

    Args:
        frames: (N, h, w), N > 1, in the data's units.
        good: (h, w) bool, usable pixels; None: all.
    """
    frames = frames.astype(np.float64)
    good = np.ones(frames.shape[1:], bool) if good is None else good
    once = map_statistics(frames[::2].mean(0), good, frames[1::2].mean(0))
    mean = frames.mean(0)
    temporal = temporal_autocorrelation(frames, good)
    return replace(
        once,
        pattern=np.where(good, mean - mean[good].mean(), 0),
        temporal=temporal,
        stable_frames=correlation_length(temporal, STABILITY_LEVEL),
    )


def quadratic_fit(pattern: Array, good: Array) -> Array:
    """Quadratic polynomial (h, w) fitted to a map (h, w) by least squares where `good` (h, w)."""
    y, x = (np.linspace(-1, 1, side) for side in pattern.shape)
    y, x = np.broadcast_arrays(y[:, None], x)
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], -1)
    weights, *_ = np.linalg.lstsq(terms[good], pattern[good], rcond=None)
    return np.asarray(terms @ weights)


def plateau(along: Array) -> float:
    """Autocorrelation (L + 1,) at large lags: the share of lines, which are fully correlated along themselves."""
    return float(np.clip(np.median(along[len(along) // 2 :]), 0, 0.99))


def correlation_length(along: Array, level: float = CORRELATION_LENGTH_LEVEL) -> float:
    """Lag at which an autocorrelation first falls below a level, by linear interpolation.

    Args:
        along: (L + 1,), from lag zero on.
        level: The level.

    Returns:
        The lag; infinite if the autocorrelation stays above.
    """
    below = np.flatnonzero(along < level)
    if not below.size:
        return float("inf")
    k = int(below[0])
    return float(k) if k == 0 else k - 1 + float((along[k - 1] - level) / (along[k - 1] - along[k]))


def temporal_autocorrelation(frames: Array, good: Array) -> Array:
    """Autocorrelation of the pattern from frame to frame, free of noise.

    Noise is in the products of a frame with itself only: lag zero is extrapolated from lags one and two.

    Args:
        frames: (N, h, w), of a uniform source.
        good: (h, w) bool, usable pixels.

    Returns:
        (K,), from lag zero to half the number of frames.
    """
    flat = np.stack([frame[good] - quadratic_fit(frame, good)[good] for frame in frames])
    products = flat @ flat.T / flat.shape[1]
    found = np.array([np.diagonal(products, k).mean() for k in range(1, max(2, len(frames) // 2 + 1))])
    start = 2 * found[0] - found[1] if len(found) > 1 else found[0]
    return np.concatenate([[1.0], found / start]) if start > 0 else np.ones(1)


@dataclass(frozen=True)
class BurstAssessment:
    """How well a burst separates the pattern from the scene."""

    displacements: Array  # (P, N, 2), motion of each frame relative to the first at P points, x and y in px
    residual_share: float  # deviation of the pattern in the registered average, over that in a frame
    flags: list[str] = field(default_factory=list)  # what the burst lacks, in words

    @property
    def independent_looks(self) -> float:
        """Number of independent patterns whose average would have the same residual."""
        return 1 / max(self.residual_share, 1e-3) ** 2


def assess_burst(statistics: PatternStatistics, motion: Array, factor: int = 1) -> BurstAssessment:
    """Assess how well a burst with a given motion separates the pattern from the scene.

    In the average of N registered frames that look at pixels d_k, the variance of the pattern is
    `1 / N^2 sum_pq r(d_p - d_q)`, with its autocorrelation r.

    Args:
        statistics: Of the pattern.
        motion: (N, 3, 3), pull homographies in px of the detector.
        factor: of super-resolution.

    Source: Saragadam et al. 2021, the variance of the estimate.
    """
    height, width = statistics.pattern.shape
    places = np.array([(x * width, y * height, 1) for y in MOTION_POINTS for x in MOTION_POINTS])
    at = np.einsum("nij,pj->pni", motion, places)
    displacements = at[..., :2] / at[..., 2:] - places[:, None, :2]
    apart = displacements[:, :, None] - displacements[:, None]
    residual_share = math.sqrt(max(float(statistics.autocorrelation_at(apart).mean()), 0.0))
    assessment = BurstAssessment(displacements, residual_share)
    assessment.flags.extend([*_motion_flags(statistics, displacements), *_frame_count_flags(assessment, len(motion))])
    if (seen := phases_seen(displacements, factor)) < MIN_PHASES * factor**2:
        assessment.flags.append(
            f"the frames show {seen:.1f} of the {factor**2} sub-pixel phases of super-resolution by {factor}: what is "
            "finer than the detector's pixels is in part the prior's; take more frames"
        )
    return assessment


def phases_seen(displacements: Array, factor: int) -> float:
    """How many of the factor^2 positions of the detector's grid on the finer one frames show; mean over points.

    Args:
        displacements: (P, N, 2), px of the detector.
        factor: of super-resolution.
    """
    steps = np.rint(displacements * factor).astype(int) % factor
    return float(np.mean([len(np.unique(each, axis=0)) for each in steps]))


def _motion_flags(statistics: PatternStatistics, displacements: Array) -> list[str]:
    """Axes along which the burst moves too little, and the line along which it moves."""
    spans = np.ptp(displacements, axis=1).mean(0)
    found = []
    for axis, across, span, want in zip("xy", "yx", spans, statistics.lengths, strict=True):
        if span < 1:
            lines = "columns" if axis == "x" else "rows"
            found.append(
                f"the burst moves along {across} only ({span:.1f} px along {axis}): "
                f"the pattern of the {lines} cannot be separated from the scene"
            )
        elif want == math.inf:
            found.append(f"no finite motion along {axis} separates the pattern from the scene")
        elif span < max(want, MIN_MOTION_SPAN):
            found.append(f"the burst moves by {span:.1f} px along {axis}: {_px(want)} are wanted")
    across_it = np.linalg.svd(displacements - displacements.mean(1, keepdims=True), full_matrices=False)
    beside = np.ptp(np.einsum("pnj,pj->pn", displacements, across_it[2][:, -1]), axis=1).mean()
    if not found and displacements.shape[1] > 2 and beside < MIN_LATERAL_MOTION:
        found.append(f"the burst moves along one line, slanted, and {beside:.1f} px across it")
    return found


def _frame_count_flags(assessment: BurstAssessment, n: int) -> list[str]:
    if n < 3:
        return [f"too few frames: {n}; take {RECOMMENDED_FRAMES[0]} or more"]
    if assessment.independent_looks < min(MIN_INDEPENDENT_LOOKS, 0.9 * n):
        return [
            f"too few frames so close together: {n} give {assessment.independent_looks:.1f} independent looks "
            "at the pattern"
        ]
    return []


def report_lines(
    statistics: PatternStatistics, assessment: BurstAssessment | None = None, scene_deviation: Array | None = None
) -> list[str]:
    """The result in lines: needed motion and frames, stability of the pattern, whether the burst suffices.

    Args:
        statistics: Of the pattern.
        assessment: Of the burst, if there is one.
        scene_deviation: (H, W), standard deviation of the scene, if it is known.
    """
    lines = [*_pattern_lines(statistics), _stability_line(statistics), _frame_count_line(statistics.stable_frames)]
    return lines if assessment is None else lines + _burst_lines(assessment, scene_deviation)


def _pattern_lines(statistics: PatternStatistics) -> list[str]:
    """Variance of the pattern, and the motion that separates it from the scene."""
    x, y = statistics.lengths
    found = {name: getattr(statistics, name) for name in ("shading", "columns", "rows")}
    found["pixels"] = 1 - sum(found.values())
    shares = (f"{name} {100 * each:.0f} %" for name, each in found.items() if each >= MIN_REPORTED_SHARE)
    lines = [f"pattern: standard deviation {statistics.pattern.std():.3g}; of its variance {', '.join(shares)}"]
    if max(x, y) == math.inf:
        lines.append(
            "the pattern is correlated over all lags that were measured: no jitter separates it from the scene"
        )
    else:
        lines.append(f"move the camera between frames by more than {_px(x)} in x and {_px(y)} in y, in both")
    if statistics.shading > 0.5:
        lines.append("most of it is shading, which jitter separates from the scene only in part: take a flat frame too")
    return lines


def _stability_line(statistics: PatternStatistics) -> str:
    if statistics.stable_frames is None:
        return "a burst does not show how long the pattern is stable: give frames of a uniform source, with --flat"
    if statistics.stable_frames == math.inf and statistics.temporal is not None:
        seen = len(statistics.temporal) - 1
        return f"the pattern is stable for longer than the {seen} frames over which it was measured"
    return f"the pattern is stable (autocorrelation above {STABILITY_LEVEL}) for {statistics.stable_frames:.0f} frames"


def _frame_count_line(stable_frames: float | None) -> str:
    fewest, most = RECOMMENDED_FRAMES
    if stable_frames is not None:
        most = max(2, int(min(most, stable_frames)))
    few = "" if most >= fewest else ", few for a good burst: raise the frame rate"
    return f"take {min(fewest, most)} to {most} frames{few}"


def _burst_lines(assessment: BurstAssessment, scene_deviation: Array | None) -> list[str]:
    """Share of the pattern in the average, weakly determined pixels of the scene, and what the burst lacks."""
    n = assessment.displacements.shape[1]
    lines = [
        f"this burst: {n} frames; averaged, they keep {100 * assessment.residual_share:.0f} % of the pattern's "
        f"deviation ({100 / n**0.5:.0f} % at best)"
    ]
    if scene_deviation is not None:
        weak = 100 * float((scene_deviation > UNCERTAIN_PIXEL_RATIO * np.median(scene_deviation)).mean())
        lines.append(
            f"{weak:.0f} % of the scene's pixels are weakly determined "
            f"(over {UNCERTAIN_PIXEL_RATIO:g} times the median)"
        )
    return lines + (assessment.flags or ["this burst suffices"])


def _px(value: float) -> str:
    """A finite motion that is needed, in words; at least what registration and interpolation need."""
    return f"{math.ceil(max(value, MIN_MOTION_SPAN)):.0f} px"
