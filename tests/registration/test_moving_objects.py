"""Moving objects are masked and inpainted; most of the frame decides, although one moves through the rest."""

import dataclasses

import numpy as np
import pytest
import torch
from registered import TONES, TONES_IN_COUNTS, WALKER, recorded, simulated

from deepir.operators.motion_models import identity
from deepir.registration import moving_objects
from deepir.registration.motion_search import coarse_search, refine, search_level
from deepir.registration.moving_objects import inpaint_background, inpaint_mean, moving_object_mask
from deepir.registration.preprocess import preprocess
from deepir.registration.robust_score import (
    absolute_residuals,
    log_likelihood_ratio,
    reregister_worst_frames,
    robust_nll,
)


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


def burst(name="astronaut", n=6):
    frames, truth = simulated(name, n_frames=n)
    return search_level(*preprocess(frames, None)), torch.from_numpy(truth)


def shifted(truth, x):
    motion = truth.clone()
    motion[:, 0, 2] += x * torch.arange(len(truth))
    return motion


@pytest.mark.parametrize("name", ["astronaut", "gravel"])
def test_true_motions_explain_more_than_others_and_than_none(name):
    level, truth = burst(name)
    still = torch.eye(3, dtype=torch.float64).expand_as(truth)
    for wrong in (still, shifted(truth, 1.0), shifted(truth, 12.0)):
        assert log_likelihood_ratio(level, wrong, truth) > 0 > log_likelihood_ratio(level, truth, wrong)


def test_an_object_in_a_seventh_of_the_frame_does_not_make_its_own_motion_better():
    level, truth = burst("moon")
    for k, frame in enumerate(level.frames):  # stripes, ten times as bright as the scene
        frame[:, 12 + 11 * k : 26 + 11 * k] += 10 * (-1) ** (torch.arange(14) // 4)
    of_object = torch.eye(3, dtype=torch.float64).repeat(len(truth), 1, 1)
    of_object[:, 0, 2] = -11 * level.factor * torch.arange(len(truth))
    assert log_likelihood_ratio(level, of_object, truth) > 0


def test_a_frame_that_is_not_used_explains_nothing_but_costs_nothing_either():
    level, truth = burst()
    fewer = truth.clone()
    fewer[3] = torch.nan
    assert absolute_residuals(level, fewer)[3].isinf().all()
    assert log_likelihood_ratio(level, truth, fewer) < 0
    assert robust_nll(level, fewer) == pytest.approx(robust_nll(level, truth), rel=0.2)


def test_frames_that_share_nothing_explain_nothing_and_two_give_no_likelihood_ratio():
    level, truth = burst()
    apart = shifted(truth, 1000.0)
    assert log_likelihood_ratio(level, apart, truth) > 1
    assert np.isfinite(robust_nll(level, apart))
    truth[2:] = torch.nan
    assert log_likelihood_ratio(level, truth, shifted(truth, 3.0)) == 0


def test_a_frame_in_a_wrong_place_is_found_again_and_the_others_stay():
    level, truth = burst("gravel")
    for k in (0, 3):
        wrong = truth.clone()
        wrong[k, :2, 2] += torch.tensor([17.0, -9.0])
        found = reregister_worst_frames(level, wrong, "rigid")
        rest = [j for j in range(6) if j != k]
        assert torch.equal(found[rest], wrong[rest])
        assert (found[k] - truth[k])[:2, 2].abs().max() < 1.5 * level.factor
    truth[2] = torch.nan  # left out, and stays so
    assert torch.equal(reregister_worst_frames(level, truth, "rigid").isnan(), truth.isnan())
