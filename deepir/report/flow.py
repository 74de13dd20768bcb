"""A picture of dense motion: hue is direction, strength of the colour is length."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import torch

from deepir.io import replace
from deepir.operators.homography import displacements
from deepir.operators.warp import project_pixels

Array = np.ndarray[Any, Any]

MOST = 4  # frames that are shown


def write_flow(path: Path, flow: Array, motion: Array) -> None:
    """Write what the flow (N, 2, h, w) has beside the homographies (N, 3, 3), of some frames, and what colours mean."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    moved = [k for k in range(len(flow)) if np.isfinite(motion[k]).all() and flow[k].any()]
    shown = (
        [moved[i] for i in np.unique(np.linspace(0, len(moved) - 1, MOST).round().astype(int))]
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
        each.imshow(colours(picture / reach), interpolation="nearest")
        each.set_title(f"frame {k}, beside its homography", fontsize=10)
        each.set_axis_off()
    x = np.linspace(-1, 1, 101)
    wheel = np.stack(np.broadcast_arrays(x, x[:, None]))
    legend.imshow(
        np.where(np.hypot(*wheel)[..., None] <= 1, colours(wheel), 1.0), extent=(-reach, reach, reach, -reach)
    )
    legend.set_title("px, x right, y down", fontsize=9)
    legend.tick_params(labelsize=8)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    with replace(path) as part:
        part.write_bytes(buffer.getvalue())


def colours(vectors: Array) -> Array:
    """(2, h, w) vectors as (h, w, 3) colours: white is zero, a length of one or more is a full colour."""
    from matplotlib.colors import hsv_to_rgb

    hue = np.arctan2(vectors[1], vectors[0]) / (2 * np.pi) % 1
    length = np.hypot(vectors[0], vectors[1]).clip(0, 1)
    return hsv_to_rgb(np.stack((hue, length, 1 - 0.15 * length), -1))
