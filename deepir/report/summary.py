"""One picture of a run: raw frame, scene and its uncertainty, gain, offset, other maps, loss."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

from deepir.io.output.palettes import DEVIATIONS, SIGNED, WHITE_HOT
from deepir.report.drawing.axes import COLOURS, Axes
from deepir.report.drawing.figure import write_figure
from deepir.report.drawing.scaled_map import draw_map, map_height
from deepir.report.panels import montage

if TYPE_CHECKING:
    from deepir.result import Result

Array = np.ndarray[Any, Any]
PANEL_WIDTH = 460  # px
PANEL_HEIGHTS = (260, 900)  # px, least and greatest
LEGEND_SHARE = 0.3  # of the height of the losses, kept free above them


def write_summary(path: Path, result: Result, example: Array) -> None:
    """Write the picture; `example` is a raw frame (h, w)."""
    size = PANEL_WIDTH, int(np.clip(map_height(example.shape, PANEL_WIDTH), *PANEL_HEIGHTS))
    scene = result.scene
    above = [
        draw_map(example, "raw frame", WHITE_HOT, size),
        draw_map(scene if scene.ndim == 2 else scene[0], "scene", WHITE_HOT, size),
    ]
    if scene.ndim == 3:
        above.append(draw_map(montage(scene), f"some of the {len(scene)} scenes", WHITE_HOT, size))
    elif "scene" in result.uncertainty:
        title = "standard deviation of the scene"
        above.append(draw_map(result.uncertainty["scene"], title, DEVIATIONS, size))
    else:
        above.append(draw_map(scene, "scene, inferno", "inferno", size))
    below = [
        draw_map(
            montage(result.gain), f"gain, std {100 * result.gain.std():.1f} %", SIGNED, size, centre=1.0
        ),
        draw_map(montage(result.offset), f"offset, std {result.offset.std():.3g}", SIGNED, size, centre=0.0),
    ]
    if result.history:
        below.append(_loss(result.history, size))
    more = {name: each for name, each in result.extra.items() if each.shape == result.gain.shape}
    for k, (name, each) in enumerate(more.items()):
        row = (above, below)[k % 2]
        row.append(draw_map(montage(each), f"{name}, std {each.std():.3g}", SIGNED, size, centre=0.0))
    write_figure(path, [above, below])


def _loss(history: list[dict[str, Any]], size: tuple[int, int]) -> Image.Image:
    stages = {
        stage: np.array([row["loss"] for row in history if row["stage"] == stage])
        for stage in dict.fromkeys(row["stage"] for row in history)
    }
    fallen = {stage: loss - loss.min() + 1 for stage, loss in stages.items()}
    highest = max(float(np.nanmax(each)) for each in fallen.values())
    title = "loss in each stage, less its least (nats)"
    limits = 0.8, 1.4 * highest * highest**LEGEND_SHARE
    axes = Axes(size, title, (0, len(history)), limits, "iteration", log=True)
    start, colours = 0, dict[str, str]()
    for stage, loss in fallen.items():
        kind = stage.rstrip(" 0123456789")  # the rounds of a stage share a colour and a name
        name = "" if kind in colours else kind
        colour = colours.setdefault(kind, COLOURS[len(colours) % len(COLOURS)])
        axes.line(np.arange(start, start + len(loss)), loss, colour, name)
        start += len(loss)
    return axes.picture()
