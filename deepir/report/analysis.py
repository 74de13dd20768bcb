"""One picture of a pattern's statistics, and of a burst's motion."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from deepir.analysis.burst_assessment import CORRELATION_LENGTH_LEVEL, STABILITY_LEVEL, Array
from deepir.io.output.tone_mapping import DEVIATIONS, SIGNED, colour_table
from deepir.report.drawing import COLOURS, Axes, draw_map, write_figure

if TYPE_CHECKING:
    from deepir.analysis import BurstAssessment, PatternStatistics

PANEL = (520, 390)  # px, width and height
FARTHEST_LAG = 25  # px, of the curves along x and y


def write_analysis(
    path: Path,
    statistics: PatternStatistics,
    assessment: BurstAssessment | None = None,
    scene_deviation: Array | None = None,
) -> None:
    """Write the picture.

    Args:
        path: A .png.
        statistics: Of the pattern.
        assessment: Of the burst, if there is one.
        scene_deviation: (H, W), standard deviation of the scene, if it is known.
    """
    pattern = statistics.pattern
    if statistics.temporal is not None:
        last = _over_time(statistics.temporal)
    elif scene_deviation is not None:
        last = draw_map(scene_deviation, "standard deviation of the scene", DEVIATIONS, PANEL)
    else:
        last = Image.new("RGB", PANEL, "white")
    above = [
        draw_map(pattern, f"pattern, std {pattern.std():.3g}", SIGNED, PANEL, centre=0.0),
        _around(statistics, assessment),
    ]
    write_figure(path, [above, [_along(statistics), last]])


def _around(statistics: PatternStatistics, assessment: BurstAssessment | None) -> Image.Image:
    """The autocorrelation, with the displacements of the frames: pale at points off the centre."""
    middle = len(statistics.correlation) // 2
    edge = middle + 0.5
    view, title = min(edge, 3 * max(statistics.lengths) + 8), "autocorrelation, 0 dark to 1 bright"
    if assessment is not None:
        view = min(edge, max(view, float(np.abs(assessment.displacements).max()) + 2))
        title += ", and where the frames look"
    axes = Axes(PANEL, title, (-view, view), (view, -view), "lag in x and y (px)", square=True)
    near = min(middle, int(view) + 1)
    shown = np.s_[middle - near : middle + near + 1]
    levels = np.round(255 * statistics.correlation[shown, shown].clip(0, 1)).astype(np.uint8)
    end = near + 0.5
    axes.image(colour_table("magma")[levels], (-end, end, end, -end))
    if assessment is not None:
        for k, place in enumerate(assessment.displacements):
            centre = k == len(assessment.displacements) // 2
            x, y = place.T
            axes.points(x, y, "deepskyblue" if centre else "steelblue", 3.5 if centre else 1.5)
    return axes.picture()


def _along(statistics: PatternStatistics) -> Image.Image:
    farthest = len(statistics.correlation) // 2
    lags, middle = np.arange(farthest + 1), statistics.correlation
    title = "autocorrelation along an axis; what stays are lines"
    axes = Axes(PANEL, title, (0, min(farthest, FARTHEST_LAG)), (-0.2, 1.02), "lag (px)")
    axes.level(CORRELATION_LENGTH_LEVEL)
    for name, along, far, colour in zip(
        "xy",
        (middle[farthest, farthest:], middle[farthest:, farthest]),
        statistics.lengths,
        COLOURS[:2],
        strict=True,
    ):
        axes.line(lags, along, colour, f"along {name}: {far:.1f} px", dots=True)
    return axes.picture()


def _over_time(in_time: Array) -> Image.Image:
    limits = min(0.0, float(in_time.min())) - 0.02, 1.05
    title = "autocorrelation from frame to frame"
    axes = Axes(PANEL, title, (0, max(len(in_time) - 1, 1)), limits, "frames apart")
    axes.level(STABILITY_LEVEL)
    axes.line(np.arange(len(in_time)), in_time, COLOURS[0], dots=True)
    return axes.picture()
