"""Scenes finer than the detector, on pictures that no network learnt from."""

import numpy as np
import pytest
from cameras import clean
from skimage.transform import resize

import deepir
from deepir.baselines.super_resolution import enlarge, sharpen, shift_and_add
from deepir.metrics import scores
from deepir.simulate import simulate
from deepir.simulate.scenes.procedural import load_picture


def shifted(picture, factor, shifts):
    """Every `factor`-th pixel of a picture from each start, and the motion that says so."""
    frames = np.stack([picture[y::factor, x::factor] for y, x in shifts])
    motion = np.tile(np.eye(3), (len(shifts), 1, 1))
    motion[:, :2, 2] = [((x - 0.5) / factor, (y - 0.5) / factor) for y, x in shifts]
    return frames, motion


def test_samples_on_the_fine_grid_give_the_picture_back():
    picture = np.random.default_rng(0).random((16, 20))
    frames, motion = shifted(picture, 2, [(0, 0), (0, 1), (1, 0), (1, 1)])
    assert np.allclose(shift_and_add(frames, np.ones(frames.shape, bool), motion, (16, 20)), picture, atol=1e-6)


def test_holes_take_what_is_about_them():
    y, x = np.mgrid[:16, :20]
    frames, motion = shifted(0.1 * x + 0.2 * y, 2, [(0, 0), (1, 1)])
    found = shift_and_add(frames, np.ones(frames.shape, bool), motion, (16, 20))
    assert np.abs(found - (0.1 * x + 0.2 * y))[2:-2, 2:-2].max() < 0.1


def test_samples_that_are_not_valid_do_not_count():
    picture = np.ones((16, 20))
    frames, motion = shifted(picture, 2, [(0, 0), (0, 1), (1, 0), (1, 1)])
    frames[:, 3, 4] = 1e6
    valid = frames < 2
    assert np.allclose(shift_and_add(frames, valid, motion, (16, 20)), 1)


def gained(name, factor):
    """PSNR above that of bicubic, of a picture as a detector's pixels see it."""
    fine = resize(load_picture(name), (96, 120), anti_aliasing=True)
    pixels = fine.reshape(96 // factor, factor, 120 // factor, factor).mean((1, 3))
    enlarged_only = enlarge(pixels, factor)
    return scores(sharpen(enlarged_only), fine)["psnr_aligned"] - scores(enlarged_only, fine)["psnr_aligned"]


@pytest.mark.parametrize("factor", [2, 3, 4])
def test_one_network_is_better_than_bicubic_at_each_factor_on_fresh_pictures(factor):
    assert min(gained(name, factor) for name in ("camera", "astronaut")) > 0.3


def test_many_frames_are_better_than_one_and_sharpened_ones_than_as_they_are():
    camera = clean(n_frames=8, shape=(48, 64), factor=2, read_noise=0.003)
    sim = simulate(load_picture("camera"), camera, seed=3)
    psnr = {
        method: scores(
            deepir.run("sr", "physics.downsample.factor=2", frames=sim.frames, method=method).scene, sim.truth.scene
        )["psnr_aligned"]
        for method in ("bicubic", "average", "shift_and_add", "vdsr")
    }
    assert psnr["vdsr"] > psnr["average"] + 0.3
    assert psnr["vdsr"] > psnr["bicubic"] + 1
    assert psnr["shift_and_add"] > psnr["bicubic"] + 0.5
