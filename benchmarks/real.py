"""Real data: a burst of a FLIR A65 from a moving car, and a 640 x 512 burst simulated from a clean thermal picture.

Is the pattern gone, and is a frame that was not used predicted? `make bench-real` prints the figures and writes the
pictures of notes/results.md. The data are not part of the project: `DEEPIR_DATA` names their folder (default
../shared/data).
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy import ndimage

import deepir
from deepir.metrics import scores
from deepir.operators import Warp
from deepir.registration import register
from deepir.report.panels import write_panels
from deepir.simulate import Settings, simulate

DATA = Path(os.environ.get("DEEPIR_DATA", "../shared/data"))
IMAGES = Path(__file__).parent.parent / "docs" / "images"
CROP = [20, 400, 60, 580]  # above the car's bonnet, within the lens's good part
HELD_OUT = 5
SHOWN, SKY = 30, np.s_[60:180, 200:360]  # frame, and where a fixed pattern is seen best
AFFINE: dict[str, Any] = {"physics": {"warp": {"motion": {"type": "affine"}}}}


def main() -> None:
    if not DATA.is_dir():
        raise SystemExit(f"{DATA} is not there: set DEEPIR_DATA to the folder of the data")
    a65()
    a65_drive()
    for number in (1, 2, 3):
        dji(number)


def a65() -> None:
    """Ten frames from a moving car."""
    y0, y1, x0, x1 = CROP
    frames = deepir.read_frames(DATA / "a65" / "a65_frames_000-009.npz").frames[:, y0:y1, x0:x1]
    result = deepir.run("nuc", frames=frames, **AFFINE)
    corrected = (frames - result.offset) / result.gain
    print(f"A65, {len(frames)} frames of {x1 - x0} x {y1 - y0}: {result.metrics['seconds']} s")
    print(f"  high-pass correlation, frames 0 and 9: {correlation(frames):.3f} raw, {correlation(corrected):.3f} after")
    kept, motion = (np.delete(frames, HELD_OUT, axis=0), register(torch.from_numpy(frames), model="affine").motion)
    for method in ("average", "joint"):
        error = held_out_error(deepir.run("nuc", frames=kept, method=method, **AFFINE), frames, motion)
        rms, middle = float(np.std(error)), float(1.4826 * np.median(np.abs(error - np.median(error))))
        print(f"  error at frame {HELD_OUT}, not used, {method}: rms {rms:.1f}, bulk {middle:.1f} counts")
    low, high = np.percentile(frames[0], [1, 99])
    panels = [
        ("A65: one frame", frames[0], low, high),
        ("corrected frame", corrected[0], low, high),
        ("gain", result.gain, *np.percentile(result.gain, [1, 99])),
    ]
    write_panels(IMAGES / "a65.png", panels)


def a65_drive() -> None:
    """All frames of that drive, by `correct`: the README's picture of a real camera."""
    parts = [DATA / "a65" / f"a65_frames_{part}.npz" for part in ("000-009", "010-069")]
    frames = np.concatenate([deepir.read_frames(part).frames for part in parts])[:, : CROP[1]]
    raw, corrected = frames[SHOWN], deepir.correct(frames).frames[SHOWN]
    limits = np.percentile(corrected, [1, 99])
    detail = np.percentile(corrected[SKY], [1, 85])
    panels = [
        ("a frame of a drive, FLIR A65, corrected", corrected, *limits),
        ("detail, as recorded", raw[SKY], *detail),
        ("corrected", corrected[SKY], *detail),
    ]
    write_panels(IMAGES / "a65_drive.png", panels)


def correlation(frames: np.ndarray) -> float:
    """Correlation of the fine detail of the first and the last frame, edges left out.

    The scene has moved between them, the fixed pattern has not.
    """
    fine = [frame - ndimage.gaussian_filter(frame, 1.0) for frame in (frames[0], frames[-1])]
    flat = np.logical_and(*(np.abs(each) < 6 * np.median(np.abs(each)) for each in fine))
    return float(np.corrcoef(fine[0][flat], fine[1][flat])[0, 1])


def held_out_error(result: Any, frames: np.ndarray, motion: torch.Tensor) -> np.ndarray:
    """Prediction of the held-out frame less the frame, where the scene covers it."""
    size = result.scene.shape
    warp = Warp(size, size, (0, 0))
    scene, pull = torch.from_numpy(result.scene)[None, None], motion[HELD_OUT : HELD_OUT + 1].float()
    seen = warp.valid(torch.ones_like(scene), motion=pull)[0, 0].bool().numpy()
    predicted = result.gain * warp(scene, motion=pull)[0, 0].numpy() + result.offset
    return (predicted - frames[HELD_OUT])[seen]


def dji(number: int) -> None:
    """Five 640 x 512 frames in counts of a clean picture, non-uniformity of the size that is measured."""
    raw = deepir.read_frames(DATA / "dji_h30t" / f"H30T_DJI_000{number}_R_1280x1024_u16.npz").frames[0]
    low, high = np.percentile(raw, [0.1, 99.9])
    camera = Settings(shape=(512, 640), counts=True, max_shift=8.0, shading=0.0, dead_pixels=0.0)
    sim = simulate(np.clip((raw - low) / (high - low), 0, 1), camera, seed=number)
    result = deepir.run("nuc", frames=sim.frames)
    average = deepir.run("nuc", frames=sim.frames, method="average").scene
    psnr = [scores(x, sim.truth.scene)["psnr_aligned"] for x in (sim.frames[0].astype(float), average, result.scene)]
    print(
        f"H30T scene {number}, 5 frames of 640 x 512 in counts: one frame {psnr[0]:.1f} dB, average {psnr[1]:.1f}, "
        f"deepir {psnr[2]:.1f}; {result.metrics['seconds']} s, {result.metrics['peak_memory_mb']} MB"
    )
    if number == 3:
        low, high = np.percentile(sim.truth.scene, [0.5, 99.5])
        panels = [
            ("one frame", sim.frames[0], low, high),
            ("average of 5", average, low, high),
            ("deepir", result.scene, low, high),
            ("truth", sim.truth.scene, low, high),
        ]
        write_panels(IMAGES / "h30t.png", panels)


if __name__ == "__main__":
    main()
