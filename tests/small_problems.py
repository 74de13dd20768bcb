"""A small burst for each problem, which a few iterations solve, and bursts of frames that are at hand."""

import numpy as np
import torch

import deepir
from deepir.burst import Burst
from deepir.simulate import Settings, simulate

SMALL = {"shape": (32, 40), "n_frames": 3}
#: Configuration: settings of the run, settings of the camera.
PROBLEMS = {
    "nuc": ([], SMALL | {"n_frames": 6, "shading": 0.5, "gain_shading": 0.2}),
    "sr": (["physics.downsample.factor=2"], SMALL | {"factor": 2}),
    "narcissus": ([], SMALL | {"stray": 0.3, "n_frames": 5}),
    "deconv": ([], SMALL | {"psf_sigma": 1.2, "sharp": True}),
    "deblur_lag": (["physics.lag.substeps=2"], SMALL | {"tau": 10.0, "motion": "shift", "n_frames": 5}),
    "flow": ([], {"shape": (48, 56), "parallax": 1.0, "n_frames": 4}),
    "multiview_nuc": ([], SMALL | {"own_scenes": True, "n_frames": 6}),
}


def whole(frames, **more):
    """A burst of frames of which each sample counts."""
    return Burst(frames.astype(np.float32), np.ones(frames.shape, bool), np.zeros(frames.shape[1:], bool), **more)


def tiny():
    """Three frames of 24 x 32 px, and their motion."""
    motion = torch.eye(3, dtype=torch.float64).repeat(3, 1, 1)
    motion[1:, :2, 2] = torch.tensor([[2.0, -1.0], [-1.5, 3.0]])
    return whole(8000 + 100 * np.random.default_rng(0).random((3, 24, 32))), motion


def frames_of(name):
    """The frames of a problem, (N, h, w)."""
    return simulate(settings=Settings(**PROBLEMS[name][1]), seed=3).frames


def solved(name, *more, iterations=1):
    """The result of a problem; `iterations` of each stage at most."""
    changes = (*PROBLEMS[name][0], "threads=1", "output.dir=null", f"solver.max_iterations={iterations}")
    return deepir.run(name, *changes, *more, frames=frames_of(name))


def difference(found, wanted):
    """The largest difference of the arrays of two results, each relative to its range."""
    pairs = [
        (np.nan_to_num(getattr(found, name)), np.nan_to_num(getattr(wanted, name)))
        for name in ("scene", "gain", "offset", "level", "motion")
    ]
    return max(float(np.abs(a - b).max() / max(np.ptp(b), 1e-9)) for a, b in pairs)
