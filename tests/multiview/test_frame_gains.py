"""Frames that are stretched by an automatic gain show how strong the pattern is in each."""

import numpy as np
import torch
from scipy import ndimage
from skimage import data

import deepir
from deepir.multiview.pattern import frame_gains

SIZE = (96, 112)


def stretched(gains, seed=0):
    """Frames of places of a picture, with one pattern, times a gain each, on levels of their own."""
    rng = np.random.default_rng(seed)
    picture = ndimage.gaussian_filter(data.camera().astype(float), 2)
    pattern = 6 * rng.standard_normal(SIZE) + 6 * rng.standard_normal(SIZE[1])
    corners = rng.integers(0, np.array(picture.shape) - SIZE, (len(gains), 2))
    scenes = np.stack([picture[y : y + SIZE[0], x : x + SIZE[1]] for y, x in corners])
    noise = 0.5 * rng.standard_normal(scenes.shape)
    levels = rng.uniform(-50, 50, len(gains))[:, None, None]
    return gains[:, None, None] * (scenes + pattern + noise) + levels, scenes, pattern


def test_the_gains_are_found_from_the_pattern():
    gains = np.array([0.5, 1.0, 2.0, 1.5, 0.8, 1.2])
    frames, _, pattern = stretched(gains)
    found = frame_gains(torch.from_numpy(frames), torch.ones(frames.shape, dtype=torch.bool), torch.from_numpy(pattern))
    assert np.allclose(found.numpy(), gains / np.exp(np.log(gains).mean()), rtol=0.03)


def test_equal_gains_are_not_estimated():
    frames, _, pattern = stretched(np.ones(6))
    usable = torch.ones(frames.shape, dtype=torch.bool)
    assert frame_gains(torch.from_numpy(frames), usable, torch.from_numpy(pattern)) is None
    nothing = torch.from_numpy(np.random.default_rng(1).standard_normal(SIZE))
    assert frame_gains(torch.from_numpy(frames), usable, nothing) is None


def test_scenes_under_an_automatic_gain_are_corrected():
    gains = np.random.default_rng(2).permutation(np.geomspace(0.5, 2, 12))
    frames, scenes, _ = stretched(gains)
    result = deepir.run("multiview_nuc", frames=frames.astype(np.float32))
    assert any("contrast of the frames differs" in m or "response drifts" in m for m in result.messages)
    for found, true, raw in zip(result.scene, scenes, frames, strict=True):
        left = [np.corrcoef(each.ravel(), true.ravel())[0, 1] for each in (found, raw)]
        assert 1 - left[0] < 0.3 * (1 - left[1])
