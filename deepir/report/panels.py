"""A row of grey pictures with titles."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

Panel = tuple[str, np.ndarray[Any, Any], float, float]


def write_panels(path: Path, panels: Sequence[Panel]) -> None:
    """Write a PNG of (title, picture (h, w), value of black, value of white), side by side, 64 grey levels."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from PIL import Image

    height, width = panels[0][1].shape
    figure = Figure(figsize=(12, 12 / len(panels) * height / width + 0.3), dpi=100)
    canvas = FigureCanvasAgg(figure)
    figure.subplots_adjust(0, 0, 1, 1 - 0.3 / figure.get_figheight(), wspace=0.02)
    for axes, (title, image, black, white) in zip(figure.subplots(1, len(panels)), panels, strict=True):
        axes.imshow(image, cmap="gray", vmin=black, vmax=white, interpolation="nearest")
        axes.set_title(title, fontsize=11, pad=4)
        axes.set_axis_off()
    canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3]).convert("L")
    picture.quantize(64, dither=Image.Dither.NONE).save(path, optimize=True)
