"""Simulated bursts with their true motions, and how far from these a registration is."""

import functools

import numpy as np
import skimage.data
import torch

from deepir.simulate import Settings, simulate

SHAPE = (128, 160)
#: Counts on a pedestal: a pixel's gain of 3 % is a pattern of 240 counts.
COUNTS = {"counts": True, "max_rotation": 2.0}
FAINT = {**COUNTS, "contrast": 60.0, "read_noise": 0.07}


@functools.cache
def simulated(name, **settings):
    """Frames `(N, H, W)` of a public picture and their true motions; the same camera for all pictures."""
    picture = getattr(skimage.data, name)().astype(float)
    picture = picture if picture.ndim == 2 else picture.mean(-1)
    picture = (picture - picture.min()) / np.ptp(picture)
    found = simulate(picture, Settings(shape=SHAPE, **settings), seed=1)
    return torch.from_numpy(found.frames.astype(np.float32)), found.truth.motion


def errors(result, truth):
    """Largest distance (px) at the corners, of each frame that is used; the truth relative to the first of them."""
    used = result.used.numpy()
    first = used.argmax()
    true = np.linalg.inv(truth[first]) @ truth[used]
    h, w = SHAPE
    corners = np.array([(x, y, 1.0) for x in (-w / 2, w / 2) for y in (-h / 2, h / 2)]).T
    a, b = result.motion.numpy()[used] @ corners, true @ corners
    assert np.array_equal(result.motion[first], np.eye(3))
    return np.linalg.norm(a[:, :2] / a[:, 2:] - b[:, :2] / b[:, 2:], axis=1).max(1)


def camera_of_tones(**settings):
    """160 x 192 px, scenes in [0, 1]; a thousand photons, no bad pixels."""
    fixed = {"shading": 0.0, "dead_pixels": 0.0, "photons": 1000.0, "read_noise": 0.002}
    return Settings(**(fixed | settings))


def apart(sim, shifts):
    """Largest distance (px) along an axis between found and true shifts."""
    return np.abs(shifts - sim.truth.motion[:, :2, 2]).max()
