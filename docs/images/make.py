"""The picture in the README: `deepir demo`, then `python docs/images/make.py`, both in the repository's root."""

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

import deepir

DEMO = Path("runs/demo")


def main() -> None:
    """Write docs/images/demo.png: a raw frame, the registered average, the scene and the gain."""
    frames = np.load(DEMO / "burst.npz")["frames"]
    result = np.load(DEMO / "result.npz")
    average = deepir.run("nuc", frames=frames, method="average")
    low, high = np.percentile(result["scene"], [0.5, 99.5])
    height, width = result["scene"].shape
    figure = Figure(figsize=(12, 3.0 * height / width + 0.3), dpi=100)
    canvas = FigureCanvasAgg(figure)
    figure.subplots_adjust(0, 0, 1, 1 - 0.3 / figure.get_figheight(), wspace=0.02)
    panels = (
        ("one frame", frames[0], low, high),
        (f"average of {len(frames)} registered frames", average.scene, low, high),
        ("deepir: scene", result["scene"], low, high),
        ("deepir: gain", result["gain"], 0.9, 1.1),
    )
    for axes, (title, image, least, most) in zip(figure.subplots(1, 4), panels, strict=True):
        axes.imshow(image, cmap="gray", vmin=least, vmax=most, interpolation="nearest")
        axes.set_title(title, fontsize=11, pad=4)
        axes.set_axis_off()
    canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3]).convert("L")
    picture.quantize(64, dither=Image.Dither.NONE).save(Path(__file__).with_name("demo.png"), optimize=True)


if __name__ == "__main__":
    main()
