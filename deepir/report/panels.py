"""Rows of grey pictures with titles."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from deepir.io.output.palettes import WHITE_HOT, colour_table
from deepir.io.output.tone_mapping import stretch
from deepir.report.drawing.figure import composed
from deepir.report.drawing.scaled_map import draw_colours, map_height

TOTAL_WIDTH = 1200  # px
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
    columns = -(-len(panels) // rows)
    width = TOTAL_WIDTH // columns
    size = width, map_height(panels[0][1].shape, width, 0)
    drawn = [
        draw_colours(
            colour_table(WHITE_HOT)[np.round(255 * stretch(image, black, white)).astype(np.uint8)],
            title,
            size,
        )
        for title, image, black, white in panels
    ]
    whole = composed([drawn[k : k + columns] for k in range(0, len(drawn), columns)]).convert("L")
    whole.quantize(64, dither=Image.Dither.NONE).save(path, format="PNG", optimize=True)
