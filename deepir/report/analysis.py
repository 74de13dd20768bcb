"""One picture of a pattern's statistics, and of a burst's motion."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from deepir.analysis import Statistics, Verdict
from deepir.analysis.statistics import CORRELATION_LENGTH_LEVEL, STABILITY_LEVEL, Array
from deepir.io import atomic_file
from deepir.report.summary import DEVIATION_PALETTE, draw_map


def write_analysis(
    path: Path, statistics: Statistics, verdict: Verdict | None = None, scene_deviation: Array | None = None
) -> None:
    """Write the picture.

    Args:
        path: A .png.
        statistics: Of the pattern.
        verdict: Of the burst, if there is one.
        scene_deviation: (H, W), standard deviation of the scene, if it is known.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 7.5), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    grid = figure.subplots(2, 2)
    draw_map(
        grid[0, 0], statistics.pattern, f"pattern (σ {statistics.pattern.std():.3g})", "RdBu_r", centre=0.0
    )
    _around(grid[0, 1], statistics, verdict)
    _along(grid[1, 0], statistics)
    if statistics.temporal is not None:
        _over_time(grid[1, 1], statistics.temporal)
    elif scene_deviation is not None:
        draw_map(grid[1, 1], scene_deviation, "standard deviation of the scene", DEVIATION_PALETTE)
    else:
        grid[1, 1].set_axis_off()
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=100)
    with atomic_file(path) as part:
        part.write_bytes(buffer.getvalue())


def _around(axes: Any, statistics: Statistics, verdict: Verdict | None) -> None:
    """The autocorrelation, with the displacements of the frames: pale at points off the centre."""
    edge = len(statistics.correlation) // 2 + 0.5
    shown = axes.imshow(
        statistics.correlation,
        cmap="magma",
        vmin=0,
        vmax=1,
        extent=(-edge, edge, edge, -edge),
        interpolation="nearest",
    )
    view, title = min(edge, 3 * max(statistics.lengths) + 8), "autocorrelation"
    if verdict is not None:
        for k, place in enumerate(verdict.displacements):
            centre = k == len(verdict.displacements) // 2
            axes.plot(
                *place.T, "o", color="deepskyblue" if centre else "steelblue", markersize=5 if centre else 2
            )
        view = min(edge, max(view, float(np.abs(verdict.displacements).max()) + 2))
        title += ", and where the frames look"
    axes.set(xlim=(-view, view), ylim=(view, -view), xlabel="x (px)", ylabel="y (px)")
    axes.set_title(title, fontsize=10)
    axes.figure.colorbar(shown, ax=axes, fraction=0.046, pad=0.02)


def _along(axes: Any, statistics: Statistics) -> None:
    farthest = len(statistics.correlation) // 2
    lags, middle = np.arange(farthest + 1), statistics.correlation
    for name, along, far in zip(
        "xy", (middle[farthest, farthest:], middle[farthest:, farthest]), statistics.lengths, strict=True
    ):
        axes.plot(lags, along, ".-", label=f"along {name}: {far:.1f} px")
    axes.axhline(CORRELATION_LENGTH_LEVEL, color="grey", linewidth=0.8, linestyle=":")
    axes.set_title("autocorrelation along an axis; what stays are lines", fontsize=10)
    axes.set(xlabel="lag (px)", xlim=(0, min(farthest, 25)), ylim=(-0.2, 1.02))
    axes.legend(fontsize=9)


def _over_time(axes: Any, in_time: Array) -> None:
    axes.plot(in_time, ".-")
    axes.axhline(STABILITY_LEVEL, color="grey", linewidth=0.8, linestyle=":")
    axes.set_title("autocorrelation from frame to frame", fontsize=10)
    axes.set(xlabel="frames apart", ylim=(min(0.0, float(in_time.min())), 1.05))
