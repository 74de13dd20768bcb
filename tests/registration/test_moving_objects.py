"""Moving objects are masked and inpainted."""

import dataclasses

import numpy as np
import pytest
import torch
from registered import TONES, TONES_IN_COUNTS, WALKER, recorded, simulated

from deepir.operators.motion_models import identity
from deepir.registration import moving_objects
from deepir.registration.motion_search import coarse_search, refine
from deepir.registration.moving_objects import inpaint_background, inpaint_mean, moving_object_mask
from deepir.registration.preprocess import preprocess


@pytest.mark.parametrize("camera", [TONES, TONES_IN_COUNTS], ids=["tones", "counts"])
def test_an_object_before_a_sky_is_detected_in_each_frame(camera):
    sim, frames = recorded("sky 2", 6, n_frames=10, **WALKER, **camera)
    stands = moving_object_mask(preprocess(frames, None)[0]).numpy()
    assert stands[sim.truth.moving].mean() > 0.9
    assert stands[~sim.truth.moving].mean() < 0.15


def test_a_frame_of_another_place_is_no_moving_object():
    frames = simulated("camera")[0].clone()
    frames[3] = simulated("gravel")[0][2]
    assert not moving_object_mask(preprocess(frames, None)[0])[3].any()


def test_an_object_is_inpainted_by_the_background():
    (sim, frames), (empty, _) = (
        recorded("drawn 3", 5, n_frames=7, **TONES | WALKER | there) for there in ({}, {"walker": 0.0})
    )
    stands, motion = torch.from_numpy(sim.truth.moving), torch.from_numpy(sim.truth.motion)
    weight = torch.ones(stands.shape[1:])

    def wrong(at):
        there = inpaint_background(frames, stands, weight, at).numpy()
        return np.median(np.abs(there - empty.frames)[stands.numpy()])

    assert wrong(motion) < 0.65 * wrong(identity(len(motion)))
    assert wrong(motion) < 0.02  # of the range, with the noise of both; the object differs by a third of it


def test_frames_that_are_well_explained_are_not_placed_again(monkeypatch):
    monkeypatch.setattr(moving_objects, "coarse_search", None)
    frames = simulated("astronaut")[0]
    one = refine(coarse_search(frames, *preprocess(frames, None), "rigid"))
    assert moving_objects.register_beside_moving_objects(one) is one


def test_bright_things_in_a_dark_scene_are_no_moving_objects_if_one_motion_explains_all(monkeypatch):
    _, frames = recorded("camera", 10, gain_column=0.1, **TONES)
    flat, weight = preprocess(frames, None)
    one = refine(coarse_search(frames, flat, weight, "rigid"))
    assert moving_object_mask(flat).any()
    with monkeypatch.context() as patch:
        patch.setattr(moving_objects, "coarse_search", None)
        assert moving_objects.register_beside_moving_objects(one) is one
    still = dataclasses.replace(one, motion=identity(len(frames)))
    assert moving_objects.is_well_explained(one)
    assert not moving_objects.is_well_explained(still)


def test_at_rest_the_background_is_the_mean_of_the_other_frames():
    frames, weight = simulated("camera")[0].float(), torch.ones(*simulated("camera")[0].shape[1:])
    stands = torch.rand(frames.shape, generator=torch.Generator().manual_seed(0)) < 0.4
    weight[3:5, 7:9] = 0
    torch.testing.assert_close(
        inpaint_mean(frames, stands, weight), inpaint_background(frames, stands, weight, identity(len(frames)))
    )
