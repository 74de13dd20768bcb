"""Far shifts, turns, stretch and keystone; large frames and small ones."""

import numpy as np
import pytest
import torch
from registered import COUNTS, SHAPE, camera_of_tones, errors, simulated

from deepir.registration import motion_search, register
from deepir.simulate import Settings, optics, simulate
from deepir.simulate.scenes.procedural import procedural, sky


@pytest.mark.parametrize("name", ["camera", "astronaut", "grass"])
def test_a_quarter_of_the_frame_and_eight_degrees_are_found(name):
    frames, truth = simulated(name, max_shift=32.0, max_rotation=8.0)
    result = register(frames)
    assert result.used.all()
    assert errors(result, truth).max() < 0.2


@pytest.mark.parametrize("model", ["affine", "homography"])
def test_a_per_cent_of_stretch_and_of_keystone_are_found(model):
    frames, truth = simulated("astronaut", motion=model, max_rotation=2.0)
    assert errors(register(frames, model=model), truth).max() < 0.4


def test_a_large_frame_is_registered_from_half_its_size(monkeypatch):
    frames, truth = simulated("camera", **COUNTS)
    monkeypatch.setattr(motion_search, "LEVELS", motion_search.LevelSettings(search_side=40))
    assert errors(register(frames), truth).max() < 0.3
    levels = motion_search.LevelSettings(search_side=40, max_final_pixels=SHAPE[0] * SHAPE[1] // 3)
    monkeypatch.setattr(motion_search, "LEVELS", levels)
    assert errors(register(frames), truth).max() < 0.5


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_frames_of_two_thousand_pixels_are_enough(seed):
    camera = Settings(n_frames=3, shape=(40, 48), counts=True, max_shift=4.0)
    found = simulate(None, camera, seed=seed)
    result = register(torch.from_numpy(found.frames.astype(np.float32)))
    assert result.used.all()
    shift = result.motion.numpy()[:, :2, 2] - found.truth.motion[:, :2, 2]
    assert np.abs(shift).max() < 1.0  # a start; the solve goes on from there


@pytest.mark.parametrize("name", ["camera", "gravel"])
def test_frames_that_bend_are_registered_as_homographies(name):
    frames, truth = simulated(name, n_frames=5, motion="homography", photons=1000.0)
    assert errors(register(frames), truth).max() > 1
    assert errors(register(frames, model="auto"), truth).max() < 0.3


@pytest.mark.parametrize("frames", [2, 3, 5])
def test_frames_that_do_not_bend_are_rigid_to_the_bit(frames):
    frames, _ = simulated("camera", n_frames=frames, max_rotation=3.0, photons=1000.0)
    assert torch.equal(register(frames, model="auto").motion, register(frames).motion)


def test_a_thousandth_of_keystone_is_found_in_three_frames(monkeypatch):
    monkeypatch.setattr(optics, "MAX_DEFORMATION", 0.002)
    frames, truth = simulated("gravel", n_frames=3, motion="homography", counts=True, offset_pixel=0.04)
    rigid = errors(register(frames), truth).max()
    assert errors(register(frames, model="auto"), truth).max() < min(0.2, rigid / 2)


@pytest.mark.parametrize(
    ("number", "seed", "camera"),
    [(4, 33, {}), (5, 32, {"counts": True, "read_noise": 0.003, "photons": 0.0})],
)
def test_what_lines_and_noise_make_of_a_plain_sky_is_no_bend(number, seed, camera):
    sim = simulate(sky(number, (430, 500)), camera_of_tones(n_frames=5, **camera), seed=seed)
    frames = torch.from_numpy(sim.frames.astype(np.float32))
    assert torch.equal(register(frames, model="auto").motion, register(frames).motion)


@pytest.mark.parametrize(
    ("seed", "step", "count"), [(2, 12, 8), (3, 12, 8), (3, 15, 10), (4, 15, 10), (5, 10, 14)]
)
def test_a_pan_by_up_to_the_whole_frame_is_followed_to_its_end(seed, step, count):
    scene, rng = procedural(seed, (130, 170 + step * count)), np.random.default_rng(seed)
    pattern = 1 + 0.03 * rng.normal(size=(120, 160)) + 0.03 * rng.normal(size=160)
    frames = np.stack([scene[k % 3 :, step * k :][:120, :160] * pattern for k in range(count)])
    frames += 0.004 * rng.normal(size=frames.shape)
    result = register(torch.from_numpy(frames.astype(np.float32)))
    assert result.used.all()
    true = np.array([(step * k, k % 3) for k in range(count)])
    assert np.abs(result.motion.numpy()[:, :2, 2] - true).max() < 0.3


def test_frames_that_turn_are_not_taken_for_shifted_ones():
    found = simulate(sky(2), Settings(shape=(160, 192), n_frames=5, counts=True, max_rotation=6.0), seed=32)
    motion = register(torch.from_numpy(found.frames.astype(np.float32))).motion
    assert np.abs(motion.numpy() - found.truth.motion)[:, :2, :2].max() < 5e-3
