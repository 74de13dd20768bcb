"""Frames of other scenes are rejected, and moving objects do not bias the motion."""

import numpy as np
import pytest
import torch
from registered import COUNTS, SHAPE, apart, camera_of_tones, errors, simulated

from deepir.registration import register, shift_likelihood
from deepir.registration.preprocess import fill_bad_pixels, variance_stabilise
from deepir.simulate import simulate
from deepir.simulate.scenes.procedural import load_picture as scene
from deepir.simulate.scenes.procedural import procedural, sky


def strangers(frames, **settings):
    """What a frame may be that does not belong: another scene, a shutter, noise, nothing."""
    generator = torch.Generator().manual_seed(0)
    noise = torch.randn(SHAPE, generator=generator)
    mean = frames.mean(0)
    shutter = frames.median() + mean - torch.nn.functional.avg_pool2d(mean[None], 5, 1, 2)[0]
    return {
        "scene": simulated("gravel", **settings)[0][2],
        "shutter": shutter + 0.01 * frames.std() * noise,
        "noise": frames.mean() + 0.5 * frames.std() * noise,
        "nothing": torch.full(SHAPE, float(frames.mean())),
    }


@pytest.mark.parametrize("settings", [{}, COUNTS], ids=["unit", "counts"])
@pytest.mark.parametrize("place", [pytest.param(0, marks=pytest.mark.slow), 3])
def test_a_frame_that_does_not_belong_is_left_out_wherever_it_is(settings, place):
    frames, truth = simulated("camera", **settings)
    alone = errors(register(frames[[k for k in range(5) if k != place]]), np.delete(truth, place, 0)).max()
    for kind, stranger in strangers(frames, **settings).items():
        spoilt = frames.clone()
        spoilt[place] = stranger
        result = register(spoilt)
        assert result.used.tolist() == [k != place for k in range(5)], kind
        assert result.motion[place].isnan().all()
        assert result.messages[0].startswith(f"frame {place} does not register")
        assert errors(result, truth).max() < alone + 0.1


def test_without_frame_0_motions_are_relative_to_the_first_that_is_used():
    frames, _ = simulated("camera")
    spoilt = frames.clone()
    spoilt[0] = simulated("gravel")[0][0]
    result = register(spoilt)
    assert torch.equal(result.motion[1], torch.eye(3, dtype=torch.float64))
    assert "relative to it" in result.messages[-1]


def test_three_frames_of_one_scene_outvote_two_of_others():
    frames, truth = simulated("astronaut")
    spoilt = frames.clone()
    spoilt[0], spoilt[3] = simulated("gravel")[0][0], simulated("moon")[0][3]
    result = register(spoilt)
    assert result.used.tolist() == [False, True, True, False, True]
    assert errors(result, truth).max() < 0.3


def test_an_object_that_goes_its_own_way_does_not_take_the_motion_along():
    frames, truth = simulated("astronaut")
    alone = errors(register(frames), truth).max()
    crossed = frames.clone()
    patch = 1.5 * simulated("gravel")[0][0, :40, :36] + 0.3  # 7 % of the frame
    for k, frame in enumerate(crossed):
        frame[30 + 3 * k : 70 + 3 * k, 20 + 12 * k : 56 + 12 * k] = patch
    result = register(crossed)
    assert result.used.all()
    assert errors(result, truth).max() < alone + 0.1


def test_a_moving_object_does_not_bias_the_likelihood():
    walker = {"walker": 0.5, "walker_contrast": 0.3}
    sim = simulate(procedural(3, (430, 500)), camera_of_tones(n_frames=5, shape=(96, 128), **walker), seed=57)
    frames = torch.from_numpy(sim.frames.astype(np.float32))
    shifts = register(frames).motion[:, :2, 2].numpy()
    followed = shift_likelihood.maximise_shift_likelihood(
        variance_stabilise(frames, torch.ones(96, 128)), shifts[1:]
    )
    assert apart(sim, np.vstack((shifts[:1], followed))) < 0.3
    assert apart(sim, shifts) < 0.2


@pytest.mark.parametrize(("number", "seed"), [(62, 62), pytest.param(30, 30, marks=pytest.mark.slow)])
def test_a_hot_object_before_a_weakly_textured_scene_is_not_followed(number, seed):
    picture = scene("moon") if number == 62 else sky(1, (430, 500))
    walker = {"walker": 0.5, "walker_contrast": 0.3}
    sim = simulate(picture, camera_of_tones(n_frames=5, **walker), seed=seed)
    frames = torch.from_numpy(sim.frames.astype(np.float32))
    assert apart(sim, register(frames).motion.numpy()[:, :2, 2]) < 0.5


def test_an_object_before_a_weakly_textured_scene_is_not_followed_in_three_frames():
    walker = {"walker": 0.5, "walker_contrast": 0.3, "walker_speed": 4.0}
    counts = {"counts": True, "read_noise": 0.004, "photons": 0.0}
    sim = simulate(scene("moon"), camera_of_tones(n_frames=3, **walker, **counts), seed=51)
    frames = torch.from_numpy(sim.frames.astype(np.float32))
    assert apart(sim, register(frames).motion.numpy()[:, :2, 2]) < 0.3


def test_a_hole_is_filled_from_around_it():
    rows = torch.arange(40.0)[:, None].expand(40, 50)
    good = torch.ones(40, 50, dtype=torch.bool)
    good[10:30, 20:40] = good[3, 3] = False
    found = fill_bad_pixels(rows[None], good)[0]
    assert torch.equal(found[good].float(), rows[good])
    assert float((found - rows)[~good].abs().max()) < 12
    assert float(found[3, 3]) == pytest.approx(3)
