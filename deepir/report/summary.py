"""One picture of a run: raw frame, scene and its uncertainty, gain, offset, other maps, loss."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from deepir.io import atomic_file
from deepir.report.panels import montage

if TYPE_CHECKING:
    from deepir.result import Result

Array = np.ndarray[Any, Any]
DEVIATION_PALETTE = "viridis"  # palette of standard deviations
LOG_SCALE_RATIO = 30.0  # largest over smallest deviation from which their scale is logarithmic


def write_summary(path: Path, result: Result, example: Array) -> None:
    """Write the picture; `example` is a raw frame (h, w)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    height, width = example.shape
    more = {name: each for name, each in result.extra.items() if each.shape == result.gain.shape}
    columns = 3 + -(-len(more) // 2)
    size = (4 * columns, 12 * 0.66 * height / width + 0.9)
    figure = Figure(figsize=size, layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    grid = figure.subplots(2, columns)
    draw_map(grid[0, 0], example, "raw frame", "gray")
    first = result.scene if result.scene.ndim == 2 else result.scene[0]
    draw_map(grid[0, 1], first, "scene", "gray")
    if result.scene.ndim == 3:
        draw_map(grid[0, 2], montage(result.scene), f"some of the {len(result.scene)} scenes", "gray")
    elif "scene" in result.uncertainty:
        draw_map(
            grid[0, 2], result.uncertainty["scene"], "standard deviation of the scene", DEVIATION_PALETTE
        )
    else:
        draw_map(grid[0, 2], result.scene, "scene, inferno", "inferno")
    draw_map(grid[1, 0], result.gain, f"gain (σ {100 * result.gain.std():.1f} %)", "RdBu_r", centre=1.0)
    draw_map(grid[1, 1], result.offset, f"offset (σ {result.offset.std():.3g})", "RdBu_r", centre=0.0)
    _loss(grid[1, 2], result.history)
    places = grid[:, 3:].T.flatten()
    for (name, each), axes in zip(more.items(), places, strict=False):
        draw_map(axes, each, f"{name} (σ {each.std():.3g})", "RdBu_r", centre=0.0)
    for axes in places[len(more) :]:
        axes.set_axis_off()
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    with atomic_file(path) as part:
        part.write_bytes(buffer.getvalue())


def draw_map(axes: Any, image: Array, title: str, palette: str, centre: float | None = None) -> None:
    """A map (h, w) with its colour scale, symmetric about the centre, if there is one; NaN has its own colour."""
    from matplotlib import colormaps

    low, high = np.nanpercentile(image, [0.5, 99.5])
    if low == high:  # all but a few are alike
        low, high = np.nanmin(image), np.nanmax(image)
    if centre is not None:
        reach = max(high - centre, centre - low, 1e-6)
        low, high = centre - reach, centre + reach
    shown = axes.imshow(
        image,
        norm="log"
        if palette == DEVIATION_PALETTE and high > LOG_SCALE_RATIO * low > 0
        else None,  # where no frame looks
        cmap=colormaps[palette].with_extremes(bad="lightsteelblue"),
        vmin=low,
        vmax=high if high > low else low + 1,
        interpolation="nearest",
    )
    axes.set_title(title, fontsize=10)
    axes.set_axis_off()
    axes.figure.colorbar(shown, ax=axes, fraction=0.046 * image.shape[0] / image.shape[1] * 1.2, pad=0.02)


def _loss(axes: Any, history: list[dict[str, Any]]) -> None:
    axes.set_title("loss in each stage, less its least (nats)", fontsize=10)
    axes.set_xlabel("iteration")
    start = 0
    colours: dict[str, str] = {}
    for stage in dict.fromkeys(row["stage"] for row in history):
        loss = np.array([row["loss"] for row in history if row["stage"] == stage])
        kind = stage.rstrip(" 0123456789")  # the rounds of a stage share a colour and a name
        label = None if kind in colours else kind
        colour = colours.setdefault(kind, f"C{len(colours)}")
        axes.semilogy(np.arange(start, start + len(loss)), loss - loss.min() + 1, color=colour, label=label)
        start += len(loss)
    if history:
        axes.legend(fontsize=8, loc="upper right")  # losses fall
