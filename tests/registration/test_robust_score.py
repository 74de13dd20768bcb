"""The robust score: most of the frame decides, although an object moves through the rest."""

import numpy as np
import pytest
import torch
from registered import simulated

from deepir.registration.motion_search import search_level
from deepir.registration.preprocess import preprocess
from deepir.registration.robust_score import (
    absolute_residuals,
    log_likelihood_ratio,
    reregister_worst_frames,
    robust_nll,
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
