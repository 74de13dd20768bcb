"""Registration and lines."""

import numpy as np

import deepir
from deepir.baselines.pixel_statistics import fit_lines, trajectory_means
from deepir.metrics import scores
from deepir.simulate import Settings, simulate


def test_lines_are_found():
    rng = np.random.default_rng(0)
    gain, bias, scene = 1 + 0.1 * rng.random((4, 5)), rng.random((4, 5)), rng.random((6, 4, 5))
    found = fit_lines(scene, gain * scene + bias)
    assert np.allclose(found[0], gain)
    assert np.allclose(found[1], bias)


def test_a_pixel_that_sees_one_value_has_an_offset_only():
    gain, bias = fit_lines(np.full((3, 1, 1), 2.0), np.full((3, 1, 1), 2.5))
    assert (gain, bias) == (1, 0.5)


def test_the_scene_along_the_motion_is_that_of_each_frame():
    # Whole shifts without pattern: what is averaged is always the same scene.
    scene = np.random.default_rng(1).random((40, 48)).cumsum(0).cumsum(1)
    shifts = [(0, 0), (3, -2), (-4, 1)]
    frames = np.stack([scene[8 + y : 32 + y, 8 + x : 40 + x] for x, y in shifts])
    motion = np.tile(np.eye(3), (3, 1, 1))
    motion[:, :2, 2] = shifts
    assert np.allclose(trajectory_means(frames, np.ones(frames.shape, bool), motion), frames)


def test_many_frames_give_the_offset_back():
    camera = Settings(
        n_frames=24, shape=(48, 64), gain_pixel=0.0, gain_column=0.0, shading=0.0, dead_pixels=0.0
    )
    sim = simulate(None, camera, seed=1)
    result = deepir.run("nuc", frames=sim.frames, method="hardie2000")
    assert np.corrcoef(result.offset.ravel(), sim.truth.offset.ravel())[0, 1] > 0.9
    before, after = (scores(each, sim.truth.scene)["psnr_aligned"] for each in (sim.frames[0], result.scene))
    assert after > before + 8
