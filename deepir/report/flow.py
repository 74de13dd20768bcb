"""A picture of dense motion: hue is direction, saturation is length."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import torch

from deepir.io import atomic_file
from deepir.operators.homography import displacements
from deepir.operators.warp import project_pixels

Array = np.ndarray[Any, Any]

MAX_SHOWN_FRAMES = 4  # frames in the picture


def write_flow(path: Path, flow: Array, motion: Array) -> None:
    """Write the deviation of some frames' flow from their homographies, with a legend.

    Args:
        path: A .png.
        flow: (N, 2, h, w), x and y, px.
        motion: (N, 3, 3), pull homographies, px.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    moved = [k for k in range(len(flow)) if np.isfinite(motion[k]).all() and flow[k].any()]
    shown = (
        [moved[i] for i in np.unique(np.linspace(0, len(moved) - 1, MAX_SHOWN_FRAMES).round().astype(int))]
        if moved
        else []
    )
    height, width = flow.shape[2:]
    points = project_pixels(torch.from_numpy(motion[shown]).double(), (height, width))
    beside = flow[shown] - displacements(points).numpy()
    reach = max(float(np.percentile(np.hypot(*beside.swapaxes(0, 1)), 99)), 1e-3) if shown else 1.0
    figure = Figure(
        figsize=(12, 12 / (len(shown) + 0.6) * height / width + 0.4), layout="constrained", facecolor="white"
    )
    FigureCanvasAgg(figure)
    *axes, legend = figure.subplots(
        1, len(shown) + 1, width_ratios=[1.0] * len(shown) + [0.5], squeeze=False
    )[0]
    for each, k, picture in zip(axes, shown, beside, strict=True):
        each.imshow(flow_colours(picture / reach), interpolation="nearest")
        each.set_title(f"frame {k}, beside its homography", fontsize=10)
        each.set_axis_off()
    x = np.linspace(-1, 1, 101)
    wheel = np.stack(np.broadcast_arrays(x, x[:, None]))
    legend.imshow(
        np.where(np.hypot(*wheel)[..., None] <= 1, flow_colours(wheel), 1.0),
        extent=(-reach, reach, reach, -reach),
    )
    legend.set_title("px, x right, y down", fontsize=9)
    legend.tick_params(labelsize=8)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    with atomic_file(path) as part:
        part.write_bytes(buffer.getvalue())


def flow_colours(vectors: Array) -> Array:
    """Vectors (2, h, w) as colours (h, w, 3): white is zero, full colour a length of one or more."""
    from matplotlib.colors import hsv_to_rgb

    hue = np.arctan2(vectors[1], vectors[0]) / (2 * np.pi) % 1
    length = np.hypot(vectors[0], vectors[1]).clip(0, 1)
    return hsv_to_rgb(np.stack((hue, length, 1 - 0.15 * length), -1))
