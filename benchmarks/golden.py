"""Results that a change of the code must keep: `make golden` compares them with `golden.json`.

Small bursts of all problems, cameras and failures. Each is kept by a hash of its arrays (the same bits, on one kind of
machine and with a warm cache of compiled kernels), the error of its scene against the truth, the stages that ran, and
its messages. `--record` writes them anew.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

import deepir
from deepir.errors import DeepIRError
from deepir.simulate import Settings, simulate

KEPT = Path(__file__).with_name("golden.json")
SMALL = {"shape": (64, 80)}
COUNTS = {"shape": (64, 80), "counts": True}
#: Name: problem, settings of the run, settings of the camera, seed.
CASES: dict[str, tuple[str, list[str], dict[str, Any], int]] = {
    "defaults": ("nuc", [], SMALL, 1),
    "half size first": ("nuc", [], {"shape": (112, 128), "offset_column": 0.3, "offset_pixel": 0.2}, 2),
    "three frames": ("nuc", [], SMALL | {"n_frames": 3}, 3),
    "counts": ("nuc", [], COUNTS | {"n_frames": 6}, 4),
    "tv": ("nuc", ["prior=tv"], SMALL, 5),
    "dip": ("nuc", ["prior=dip", "solver.max_iterations=15"], SMALL, 6),
    "siren": ("nuc", ["prior=siren", "solver.max_iterations=15"], SMALL, 6),
    "homography": ("nuc", [], SMALL | {"motion": "homography", "max_rotation": 1.0, "n_frames": 6}, 7),
    "walker": ("nuc", [], {"shape": (96, 112), "walker": 0.4, "n_frames": 6}, 8),
    "failed frame": ("nuc", [], SMALL | {"failed_frame": 3, "n_frames": 6}, 9),
    "level drift": ("nuc", [], SMALL | {"level_drift": 0.02, "n_frames": 6}, 10),
    "jumping rows": ("nuc", [], SMALL | {"row_noise": 0.02}, 11),
    "shading": ("nuc", [], SMALL | {"shading": 0.5, "gain_shading": 0.2, "n_frames": 8}, 12),
    "dead pixels": ("nuc", [], SMALL | {"dead_pixels": 0.03, "stuck_pixels": 0.01}, 13),
    "clipped": ("nuc", [], COUNTS | {"pedestal": 15500.0}, 14),
    "strong pattern": ("nuc", [], SMALL | {"offset_pixel": 0.3, "offset_column": 0.3}, 15),
    "faint scene": ("nuc", [], COUNTS | {"contrast": 60.0}, 16),
    "bolometer": ("nuc", [], COUNTS | {"bolometer": True, "n_frames": 8}, 17),
    "generic plan": ("nuc", ["problem=generic"], SMALL, 18),
    "given noise": ("nuc", ["noise.read=0.003"], SMALL, 19),
    "no motion": ("nuc", [], SMALL | {"max_shift": 0.0}, 20),
    "one frame": ("nuc", [], SMALL | {"n_frames": 1}, 21),
    "super-resolution": ("sr", ["physics.downsample.factor=2"], SMALL | {"factor": 2, "n_frames": 8}, 22),
    "narcissus": ("narcissus", [], SMALL | {"stray": 0.3, "n_frames": 8, "shading": 0.0}, 23),
    "deconvolution": ("deconv", [], SMALL | {"psf_sigma": 1.2, "sharp": True, "n_frames": 8}, 24),
    "lag": ("deblur_lag", [], SMALL | {"tau": 10.0, "n_frames": 12, "motion": "shift"}, 25),
    "parallax": ("flow", [], {"shape": (72, 88), "parallax": 3.0, "n_frames": 6}, 26),
    "different scenes": ("multiview_nuc", [], SMALL | {"own_scenes": True, "n_frames": 10}, 27),
    "gradient consensus": (
        "multiview_nuc",
        ["method=gradient_consensus"],
        SMALL | {"own_scenes": True, "n_frames": 10},
        27,
    ),
    "constant statistics": ("nuc", ["method=constant_statistics"], SMALL | {"n_frames": 8}, 28),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--record", action="store_true", help=f"write {KEPT.name} anew")
    parser.add_argument("--only", default="", help="cases whose name contains this")
    options = parser.parse_args()
    torch.set_num_threads(2)
    kept = json.loads(KEPT.read_text()) if KEPT.exists() else {}
    found, changed, began = {}, 0, time.monotonic()
    for name, case in CASES.items():
        if options.only not in name:
            continue
        found[name] = outcome(*case)
        line = difference(kept.get(name, {}), found[name])
        changed += line != "same bits"
        print(f"{name:20} {line}", flush=True)
    print(f"{len(found)} cases, {changed} changed, {time.monotonic() - began:.0f} s")
    if options.record:
        KEPT.write_text(json.dumps(kept | found, indent=1, ensure_ascii=False) + "\n")
    elif changed:
        sys.exit(1)


def outcome(problem: str, settings: list[str], camera: dict[str, Any], seed: int) -> dict[str, Any]:
    """What a run gives, in words and numbers that fit into JSON."""
    burst = simulate(settings=Settings(**camera), seed=seed)
    began = time.monotonic()
    try:
        result = deepir.run(problem, *settings, frames=burst.frames)
    except DeepIRError as error:
        return {"refused": str(error)}
    digest = hashlib.sha256()
    for array in (result.scene, result.gain, result.offset, result.motion):
        digest.update(np.ascontiguousarray(array).tobytes())
    return {
        "bits": digest.hexdigest()[:16],
        "error_db": round(error_db(result.scene, burst.truth.scene), 3),
        "stages": list(dict.fromkeys(row["stage"] for row in result.history)),
        "messages": list(result.messages),
        "seconds": round(time.monotonic() - began, 1),
    }


def error_db(scene: np.ndarray, truth: np.ndarray) -> float:
    """PSNR of the scene, levels and margins aside, dB."""
    truth = truth[0] if truth.ndim == 3 else truth
    scene = scene[0] if scene.ndim == 3 else scene
    margin = tuple(
        slice((a - min(a, b)) // 2 + 2, (a + min(a, b)) // 2 - 2) for a, b in zip(truth.shape, scene.shape, strict=True)
    )
    inner = tuple(
        slice((b - min(a, b)) // 2 + 2, (b + min(a, b)) // 2 - 2) for a, b in zip(truth.shape, scene.shape, strict=True)
    )
    rest = scene[inner].astype(np.float64) - truth[margin]
    return float(20 * np.log10(np.ptp(truth) / np.std(rest)))


def difference(kept: dict[str, Any], found: dict[str, Any]) -> str:
    """What is not as it was."""
    if not kept:
        return "new"
    if "refused" in kept or "refused" in found:
        same = kept.get("refused") == found.get("refused")
        return "same bits" if same else f"refusal: {kept.get('refused')!r} -> {found.get('refused')!r}"
    words = [
        f"{key}: {[each for each in kept[key] if each not in found[key]]} -> "
        f"{[each for each in found[key] if each not in kept[key]]}"
        for key in ("stages", "messages")
        if kept[key] != found[key]
    ]
    if kept["bits"] != found["bits"]:
        words.append(f"{found['error_db'] - kept['error_db']:+.3f} dB ({found['error_db']:.2f})")
    return "; ".join(words) or "same bits"


if __name__ == "__main__":
    main()
