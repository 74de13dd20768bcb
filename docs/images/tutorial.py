"""The pictures in docs/tutorials/burst.md: run its commands first, then this, in the same folder."""

from pathlib import Path

import numpy as np

from deepir.report.panels import write_panels

HERE = Path(__file__).parent


def main() -> None:
    """Write docs/images/tutorial.png (what a run finds) and tutorial_line.png (what motion along x only leaves)."""
    frames = np.load("burst.npz")["frames"]
    result = np.load("runs/nuc/result.npz")
    low, high = np.percentile(result["scene"], [0.5, 99.5])
    found = [
        ("one frame", frames[0], low, high),
        ("scene", result["scene"], low, high),
        ("gain", result["gain"], 0.9, 1.1),
        ("offset", result["offset"], -250, 250),
    ]
    write_panels(HERE / "tutorial.png", found)
    left = [
        ("moved along x and y: error of the scene", error("nuc", "burst"), -100, 100),
        ("moved along x only: error of the scene", error("line", "line"), -100, 100),
    ]
    write_panels(HERE / "tutorial_line.png", left)


def error(run: str, burst: str) -> np.ndarray:
    """What a run's scene is above the true one, counts."""
    return np.load(f"runs/{run}/result.npz")["scene"] - np.load(f"{burst}_truth.npz")["scene"]


if __name__ == "__main__":
    main()
