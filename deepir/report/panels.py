"""Rows of grey pictures with titles."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

Panel = tuple[str, np.ndarray[Any, Any], float, float]


def montage(scenes: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """One picture of a scene (H, W), or of up to four of the scenes (N, H, W) side by side."""
    if scenes.ndim == 2:
        return scenes
    chosen = scenes[evenly_spaced(len(scenes))]
    rows = [np.concatenate(list(pair), axis=1) for pair in (chosen[:2], chosen[2:]) if len(pair)]
    missing = rows[0].shape[1] - rows[-1].shape[1]
    rows[-1] = np.pad(rows[-1], ((0, 0), (0, missing)), constant_values=np.nan)
    return np.concatenate(rows)


def evenly_spaced(count: int) -> list[int]:
    """Four or fewer of `count` indices, from the first to the last."""
    found: list[int] = np.linspace(0, count - 1, min(count, 4)).round().astype(int).tolist()
    return found


def write_panels(path: Path, panels: Sequence[Panel], rows: int = 1) -> None:
    """Write a PNG of (title, picture (h, w), value of black, value of white), in `rows`, 64 grey levels."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from PIL import Image

    height, width = panels[0][1].shape
    columns = -(-len(panels) // rows)
    tall = 12 / columns * height / width
    figure = Figure(figsize=(12, rows * (tall + 0.3)), dpi=100)
    canvas = FigureCanvasAgg(figure)
    figure.subplots_adjust(0, 0, 1, 1 - 0.3 / figure.get_figheight(), wspace=0.02, hspace=0.3 / tall)
    places = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in places:
        axes.set_axis_off()
    for axes, (title, image, black, white) in zip(places, panels, strict=False):
        axes.imshow(image, cmap="gray", vmin=black, vmax=white, interpolation="nearest")
        axes.set_title(title, fontsize=11, pad=4)
    canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3]).convert("L")
    picture.quantize(64, dither=Image.Dither.NONE).save(path, optimize=True)
