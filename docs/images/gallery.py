"""The pictures in docs/tutorials/gallery.md: run this in the repository's root; it runs the commands of that page."""

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from deepir.report.panels import montage

HERE = Path(__file__).parent
PAGE = HERE.parent / "tutorials" / "gallery.md"
SECTION = re.compile(r"^## (\w+)$.*?^```sh\n(.*?)^```$", re.MULTILINE | re.DOTALL)
GAP = 4  # px, between the two
WIDEST = 800  # px


def main() -> None:
    """Write docs/images/gallery/NAME.png for each section of the page."""
    for name, commands in SECTION.findall(PAGE.read_text(encoding="utf-8")):
        with tempfile.TemporaryDirectory() as folder:
            path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
            environment = os.environ | {"PATH": path, "PYTHONPATH": str(HERE.parent.parent)}
            subprocess.run(commands, shell=True, check=True, cwd=folder, env=environment)
            frames = np.load(Path(folder, "burst.npz"))["frames"]
            scene = np.load(Path(folder, f"runs/{name}/result.npz"))["scene"]
        picture = beside(
            montage((frames if scene.ndim == 3 else frames[len(frames) // 2]).astype(float)), montage(scene)
        )
        picture.save(HERE / "gallery" / f"{name}.png", optimize=True)


def beside(frame: np.ndarray, scene: np.ndarray) -> Image.Image:
    """A frame, enlarged to the scene's size, and the scene, in the scene's shades of 64 greys."""
    factor = scene.shape[0] // frame.shape[0]
    low, high = np.nanpercentile(scene, [0.5, 99.5])
    shades = [
        np.uint8(255 * np.clip((each - low) / (high - low), 0, 1))
        for each in (frame.repeat(factor, 0).repeat(factor, 1).astype(float), scene)
    ]
    gap = np.full((scene.shape[0], GAP), 255, np.uint8)
    picture = Image.fromarray(np.concatenate([shades[0], gap, shades[1]], axis=1))
    times = max(1, WIDEST // picture.width)
    larger = picture.resize((times * picture.width, times * picture.height), Image.Resampling.NEAREST)
    return larger.quantize(64, dither=Image.Dither.NONE)


if __name__ == "__main__":
    main()
