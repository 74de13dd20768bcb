"""Simulated bursts with their true motions, and how far from these a registration is."""

import functools

import numpy as np
import torch

from deepir.simulate import Settings, simulate
from deepir.simulate.scenes.procedural import load_picture, procedural, sky

SHAPE = (128, 160)
COUNTS = {"counts": True, "max_rotation": 2.0}  # counts on a pedestal: a pixel's gain of 3 % is a pattern of 240 counts
FAINT = {**COUNTS, "contrast": 60.0, "read_noise": 0.07}
#: 160 x 192 px, scenes in [0, 1]: a thousand photons, no bad pixels; and the same in counts.
TONES = {"shading": 0.0, "dead_pixels": 0.0, "photons": 1000.0, "read_noise": 0.002}
TONES_IN_COUNTS = TONES | {"counts": True, "photons": 0.0, "read_noise": 0.003}
WALKER = {"walker": 0.5, "walker_contrast": 0.3}


def scene(name):
    """A picture of scikit-image, or a drawn scene of 430 x 500 px by its number: `moon`, `sky 2`, `drawn 3 ** 2`."""
    kind, number, *power = name.replace("**", "").split() if " " in name else (name, 0)
    drawn = {"sky": sky, "drawn": procedural}.get(kind)
    return drawn(int(number), (430, 500)) ** int(*power or (1,)) if drawn else load_picture(name)


def recorded(name, seed=1, **settings):
    """What a camera records of a scene, and its frames (N, H, W) as a tensor."""
    picture = scene(name) if isinstance(name, str) else name
    sim = simulate(picture, Settings(**settings), seed=seed)
    return sim, torch.from_numpy(sim.frames.astype(np.float32))


@functools.cache
def simulated(name, **settings):
    """Frames `(N, H, W)` of 128 x 160 px and their true motions."""
    sim, frames = recorded(name, **{"shape": SHAPE} | settings)
    return frames, sim.truth.motion


def errors(result, truth, shape=SHAPE):
    """Largest distance (px) at the corners, of each frame that is used; the truth relative to the first of them."""
    used = result.used.numpy()
    first = used.argmax()
    true = np.linalg.inv(truth[first]) @ truth[used]
    h, w = shape
    corners = np.array([(x, y, 1.0) for x in (-w / 2, w / 2) for y in (-h / 2, h / 2)]).T
    a, b = result.motion.numpy()[used] @ corners, true @ corners
    assert np.array_equal(result.motion[first], np.eye(3))
    return np.linalg.norm(a[:, :2] / a[:, 2:] - b[:, :2] / b[:, 2:], axis=1).max(1)
