"""Shift and add."""

import numpy as np

import deepir
from deepir.baselines.super_resolution import shift_and_add
from deepir.metrics import scores
from deepir.simulate import Settings, simulate


def shifted(picture, factor, shifts):
    """Every `factor`-th pixel of a picture from each start, and the motion that says so."""
    frames = np.stack([picture[y::factor, x::factor] for y, x in shifts])
    motion = np.tile(np.eye(3), (len(shifts), 1, 1))
    motion[:, :2, 2] = [((x - 0.5) / factor, (y - 0.5) / factor) for y, x in shifts]
    return frames, motion


def test_samples_on_the_fine_grid_give_the_picture_back():
    picture = np.random.default_rng(0).random((16, 20))
    frames, motion = shifted(picture, 2, [(0, 0), (0, 1), (1, 0), (1, 1)])
    assert np.allclose(
        shift_and_add(frames, np.ones(frames.shape, bool), motion, (16, 20)), picture, atol=1e-6
    )


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


def test_it_is_finer_than_one_frame_enlarged():
    settings = Settings(
        n_frames=16, shape=(48, 64), factor=2, gain_pixel=0.0, gain_column=0.0, offset_pixel=0.0, offset_column=0.0,
        offset_row=0.0, shading=0.0, dead_pixels=0.0, psf_sigma=0.0,
    )  # fmt: skip
    sim = simulate(None, settings, seed=3)
    psnr = {
        method: scores(
            deepir.run("sr", "physics.downsample.factor=2", frames=sim.frames, method=method).scene,
            sim.truth.scene,
        )["psnr_aligned"]
        for method in ("bicubic", "shift_and_add")
    }
    assert psnr["shift_and_add"] > psnr["bicubic"] + 0.5
