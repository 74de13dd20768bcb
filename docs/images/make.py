"""The picture in the README: `deepir demo`, then `python docs/images/make.py`, both in the repository's root."""

from pathlib import Path

import numpy as np

import deepir
from deepir.report.panels import write_panels

DEMO = Path("runs/demo")


def main() -> None:
    """Write docs/images/demo.png: a raw frame, the registered average, the scene and the gain."""
    frames = np.load(DEMO / "burst.npz")["frames"]
    result = np.load(DEMO / "result.npz")
    average = deepir.run("nuc", frames=frames, method="average")
    low, high = np.percentile(result["scene"], [0.5, 99.5])
    panels = [
        ("one frame", frames[0], low, high),
        (f"average of {len(frames)} registered frames", average.scene, low, high),
        ("deepir: scene", result["scene"], low, high),
        ("deepir: gain", result["gain"], 0.9, 1.1),
    ]
    write_panels(Path(__file__).with_name("demo.png"), panels)


if __name__ == "__main__":
    main()
