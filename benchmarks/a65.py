"""A real burst, FLIR A65 from a moving car: is the pattern gone, and is a frame that was not used predicted?

The data are not part of the project: `DEEPIR_DATA` names their folder (default ../shared/data).
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy import ndimage

import deepir
from deepir.operators import Warp
from deepir.registration import register

CROP = [20, 412, 60, 580]  # above the car's bonnet, within the lens's good part
HELD_OUT = 5


def main() -> None:
    folder = Path(os.environ.get("DEEPIR_DATA", "../shared/data"))
    path = folder / "a65" / "a65_frames_000-009.npz"
    if not path.exists():
        raise SystemExit(f"{path} is not there: set DEEPIR_DATA to the folder of the data")
    frames = deepir.read_frames(path).frames[:, CROP[0] : CROP[1], CROP[2] : CROP[3]]
    options: dict[str, Any] = {"physics": {"warp": {"motion": {"type": "affine"}}}}

    result = deepir.run("nuc", frames=frames, **options)
    corrected = (frames - result.offset) / result.gain
    print(f"{len(frames)} frames of {frames.shape[2]} x {frames.shape[1]}: {result.metrics['seconds']} s")
    print(
        f"high-pass correlation of frames 0 and 9: {correlation(frames):.3f}, corrected {correlation(corrected):.3f}"
    )

    kept = np.delete(frames, HELD_OUT, axis=0)
    motion = register(torch.from_numpy(frames), model="affine").motion
    for method in ("average", "joint"):
        found = deepir.run("nuc", frames=kept, method=method, **options)
        print(
            f"error at frame {HELD_OUT}, not used, {method}: {held_out_error(found, frames, motion):.2f} counts"
        )


def correlation(frames: np.ndarray) -> float:
    """Correlation of the fine detail of the first and the last frame, edges left out: the scene has moved, the
    fixed pattern has not."""
    fine = [frame - ndimage.gaussian_filter(frame, 1.0) for frame in (frames[0], frames[-1])]
    flat = np.logical_and(*(np.abs(each) < 6 * np.median(np.abs(each)) for each in fine))
    return float(np.corrcoef(fine[0][flat], fine[1][flat])[0, 1])


def held_out_error(result: Any, frames: np.ndarray, motion: torch.Tensor) -> float:
    """Root mean square error of the prediction of the held-out frame, its level aligned, where the scene covers it."""
    size = result.scene.shape
    warp = Warp(size, size, (0, 0))
    scene = torch.from_numpy(result.scene)[None, None]
    pull = motion[HELD_OUT : HELD_OUT + 1].float()
    seen = warp.valid(torch.ones_like(scene), motion=pull)[0, 0].bool().numpy()
    predicted = result.gain * warp(scene, motion=pull)[0, 0].numpy() + result.offset
    error = (predicted - frames[HELD_OUT])[seen]
    return float(np.std(error))


if __name__ == "__main__":
    main()
