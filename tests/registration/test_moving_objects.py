"""Moving objects are masked and inpainted, and the scene registers."""

import dataclasses

import numpy as np
import pytest
import torch
from registered import apart, camera_of_tones, simulated

from deepir.operators.motion_models import identity
from deepir.registration import moving_objects, register
from deepir.registration.motion_search import estimate_motion
from deepir.registration.moving_objects import inpaint_background, inpaint_mean, moving_object_mask
from deepir.registration.preprocess import preprocess
from deepir.simulate import simulate
from deepir.simulate.scenes.procedural import load_picture as scene
from deepir.simulate.scenes.procedural import procedural, sky

WALKER = {"walker": 0.5, "walker_contrast": 0.3}
COUNTS = {"counts": True, "read_noise": 0.004, "photons": 0.0}


def flat_of(sim):
    return preprocess(torch.from_numpy(sim.frames.astype(np.float32)), None)


@pytest.mark.parametrize("camera", [{}, COUNTS], ids=["tones", "counts"])
def test_an_object_before_a_sky_is_detected_in_each_frame(camera):
    sim = simulate(sky(2, (430, 500)), camera_of_tones(n_frames=10, **WALKER, **camera), seed=6)
    stands = moving_object_mask(flat_of(sim)[0]).numpy()
    assert stands[sim.truth.moving].mean() > 0.9
    assert stands[~sim.truth.moving].mean() < 0.15


def test_a_frame_of_another_place_is_no_moving_object():
    frames = simulated("camera")[0].clone()
    frames[3] = simulated("gravel")[0][2]
    assert not moving_object_mask(preprocess(frames, None)[0])[3].any()


def test_an_object_is_inpainted_by_the_background():
    settings = camera_of_tones(n_frames=7, **WALKER)
    sim, empty = (
        simulate(procedural(3, (430, 500)), each, seed=5)
        for each in (settings, dataclasses.replace(settings, walker=0.0))
    )
    stands, motion = torch.from_numpy(sim.truth.moving), torch.from_numpy(sim.truth.motion)
    frames, weight = torch.from_numpy(sim.frames).float(), torch.ones(stands.shape[1:])

    def wrong(at):
        there = inpaint_background(frames, stands, weight, at).numpy()
        return np.median(np.abs(there - empty.frames)[stands.numpy()])

    assert wrong(motion) < 0.65 * wrong(identity(len(motion)))
    assert wrong(motion) < 0.02  # of the range, with the noise of both; the object differs by a third of it


@pytest.mark.parametrize(
    ("picture", "n_frames", "seed", "camera"),
    [
        (procedural(6, (430, 500)), 10, 76, {}),  # three frames followed the object,
        (scene("moon"), 10, 61, {}),  # all did, and were said not to move,
        pytest.param(sky(2, (430, 500)), 20, 19, COUNTS, marks=pytest.mark.slow),
        pytest.param(sky(5, (430, 500)), 5, 1, COUNTS, marks=pytest.mark.slow),
        (sky(6, (430, 500)), 3, 52, {}),  # or nearly all of them
    ],
)
def test_what_registers_is_the_scene(picture, n_frames, seed, camera):
    sim = simulate(picture, camera_of_tones(n_frames=n_frames, **WALKER, **camera), seed=seed)
    result = register(torch.from_numpy(sim.frames.astype(np.float32)))
    assert result.used.all()
    assert apart(sim, result.motion.numpy()[:, :2, 2]) < 0.5


def test_frames_that_are_well_explained_are_not_placed_again(monkeypatch):
    monkeypatch.setattr(moving_objects, "coarse_search", None)
    frames = simulated("astronaut")[0]
    one = estimate_motion(frames, *preprocess(frames, None), "rigid")
    assert moving_objects.register_beside_moving_objects(one, torch.ones(frames.shape[1:]), "rigid") is one


def test_bright_things_in_a_dark_scene_are_no_moving_objects_if_one_motion_explains_all(monkeypatch):
    sim = simulate(scene("camera"), camera_of_tones(gain_column=0.1), seed=10)
    frames = torch.from_numpy(sim.frames)
    flat, weight = flat_of(sim)
    one = estimate_motion(frames, flat, weight, "rigid")
    assert moving_object_mask(flat).any()
    with monkeypatch.context() as patch:
        patch.setattr(moving_objects, "coarse_search", None)
        assert moving_objects.register_beside_moving_objects(one, weight, "rigid") is one
    still = dataclasses.replace(one, motion=identity(len(frames)))
    assert moving_objects.is_well_explained(one, weight)
    assert not moving_objects.is_well_explained(still, weight)


def test_a_scene_that_rotates_is_no_moving_object():
    # Its dark figure moves otherwise than the rest: parts of the frame that voted put it 24 px off.
    sim = simulate(scene("camera"), camera_of_tones(n_frames=3, gain_column=0.05, max_rotation=6.0), seed=41)
    result = register(torch.from_numpy(sim.frames.astype(np.float32)))
    assert apart(sim, result.motion.numpy()[:, :2, 2]) < 0.5


def test_at_rest_the_background_is_the_mean_of_the_other_frames():
    frames, weight = simulated("camera")[0].float(), torch.ones(*simulated("camera")[0].shape[1:])
    stands = torch.rand(frames.shape, generator=torch.Generator().manual_seed(0)) < 0.4
    weight[3:5, 7:9] = 0
    torch.testing.assert_close(
        inpaint_mean(frames, stands, weight),
        inpaint_background(frames, stands, weight, identity(len(frames))),
    )


@pytest.mark.parametrize("reach", [0.0, 2.0])
def test_rest_is_recognised_beside_an_object_that_changes_the_frames_more(reach):
    camera = camera_of_tones(
        n_frames=5, shape=(96, 128), max_shift=reach, walker=0.6, walker_contrast=0.5, **COUNTS
    )
    sim = simulate(procedural(5, (400, 500)), camera, seed=5)
    found = register(torch.from_numpy(sim.frames.astype(np.float32)))
    assert found.used.all()
    off = np.abs(found.motion.numpy() - sim.truth.motion)[:, :2, 2]
    assert off.max() < (0.3 if reach else 0.05)
