"""A picture of dense motion: hue is direction, saturation is length."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image

from deepir.operators.motion_models import displacements
from deepir.operators.warp import project_pixels
from deepir.report.drawing import Axes, draw_colours, map_height, write_figure

Array = np.ndarray[Any, Any]

MAX_SHOWN_FRAMES = 4  # frames in the picture
PANEL_WIDTH, LEGEND_WIDTH = 330, 260  # px


def write_flow(path: Path, flow: Array, motion: Array) -> None:
    """Write the deviation of some frames' flow from their homographies, with a legend.

    Args:
        path: A .png.
        flow: (N, 2, h, w), x and y, px.
        motion: (N, 3, 3), pull homographies, px.
    """
    moved = [k for k in range(len(flow)) if np.isfinite(motion[k]).all() and flow[k].any()]
    shown = (
        [moved[i] for i in np.unique(np.linspace(0, len(moved) - 1, MAX_SHOWN_FRAMES).round().astype(int))]
        if moved
        else []
    )
    size = flow.shape[2:]
    points = project_pixels(torch.from_numpy(motion[shown]).double(), size)
    beside = flow[shown] - displacements(points).numpy()
    reach = max(float(np.percentile(np.hypot(*beside.swapaxes(0, 1)), 99)), 1e-3) if shown else 1.0
    height = max(map_height(size, PANEL_WIDTH, 0), LEGEND_WIDTH)
    panels = [
        draw_colours(
            flow_colours(picture / reach), f"frame {k}, beside its homography", (PANEL_WIDTH, height)
        )
        for k, picture in zip(shown, beside, strict=True)
    ]
    write_figure(path, [[*panels, _legend(reach, height)]])


def _legend(reach: float, height: int) -> Image.Image:
    """Colours of the vectors up to `reach`, px."""
    x = np.linspace(-1, 1, 201)
    wheel = np.stack(np.broadcast_arrays(x, x[:, None]))
    colours = np.where(np.hypot(*wheel)[..., None] <= 1, flow_colours(wheel), 255).astype(np.uint8)
    limits = (-reach, reach), (reach, -reach)
    axes = Axes((LEGEND_WIDTH, height), "px, x right, y down", *limits, square=True)
    axes.image(colours, (*limits[0], *limits[1]))
    return axes.picture()


def flow_colours(vectors: Array) -> Array:
    """Vectors (2, h, w) as colours (h, w, 3), uint8: white is zero, full colour a length of one or more."""
    hue = np.arctan2(vectors[1], vectors[0]) / (2 * np.pi) % 1
    length = np.hypot(vectors[0], vectors[1]).clip(0, 1)
    levels = np.stack((hue, length, 1 - 0.15 * length), -1)
    whole = np.round(255 * levels).astype(np.uint8)
    return np.asarray(Image.frombytes("HSV", whole.shape[1::-1], whole.tobytes()).convert("RGB"))
