"""Frames of other scenes, of a closed shutter, and repeated ones are left out; lost samples and objects are not."""

import numpy as np
import pytest
import torch
from registered import COUNTS, SHAPE, TONES, TONES_IN_COUNTS, errors, recorded, simulated

import deepir
from deepir.arrays.windows import fill_nearest
from deepir.registration import frame_selection, register, shift_likelihood
from deepir.registration.preprocess import fill_bad_pixels, variance_stabilise


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
    sim, frames = recorded("drawn 3", 57, shape=(96, 128), **TONES | walker)
    found, truth = register(frames).motion[:, :2, 2].numpy(), sim.truth.motion[:, :2, 2]
    stable = variance_stabilise(frames, torch.ones(96, 128))
    followed = shift_likelihood.maximise(shift_likelihood.ShiftLikelihood(stable), found[1:])
    assert np.abs(followed - truth[1:]).max() < 0.3
    assert np.abs(found - truth).max() < 0.2


def shut(name, places, seed=4):
    """Seven frames of a scene; those at the places are of a closed shutter."""
    sim, frames = recorded(name, seed, n_frames=7, **TONES_IN_COUNTS)
    rng, truth = np.random.default_rng(seed), sim.truth
    level = float(sim.frames.mean()) / float(truth.gain.mean()) - float(truth.offset.mean())
    for k in places:
        pattern = truth.gain * level + truth.offset
        frames[k] = torch.from_numpy(np.round(pattern + 3 * rng.normal(size=pattern.shape)))
    return frames


@pytest.mark.parametrize(
    ("name", "places"),
    [("drawn 3", (0,)), ("drawn 5", (3,)), ("drawn 5", (6,)), ("drawn 3", (2, 3)), ("drawn 5", (0, 1, 2))],
)
def test_frames_of_a_closed_shutter_are_left_out(name, places):
    frames = shut(name, places)
    result = register(frames)
    assert (~result.used).nonzero()[:, 0].tolist() == list(places)
    said = [message for message in result.messages if "shutter" in message]
    assert [int(message.split()[1]) for message in said] == list(places)
    others = result.used.numpy()
    assert torch.allclose(result.motion[others], register(frames[others]).motion, atol=0.02)


@pytest.mark.parametrize(("name", "seed"), [("drawn 3", 0), ("drawn 5", 1), ("sky 2", 2), ("sky 2", 3)])
def test_frames_of_a_scene_are_not_taken_for_a_shutter(name, seed):
    assert register(shut(name, (), seed)).used.all()


def test_frames_that_are_read_twice_are_used_once():
    frames, _ = simulated("camera", n_frames=4)
    once, twice = register(frames), register(frames.repeat_interleave(2, 0))
    assert twice.used.tolist() == [True, False] * 4
    assert torch.allclose(twice.motion[::2], once.motion, atol=1e-6)
    assert twice.messages == [f"frame {k} is the same as the one before it: left out" for k in (1, 3, 5, 7)]
    by_turns = register(frames[[0, 1, 0, 1, 0]])
    assert by_turns.used.tolist() == [True, True, False, False, False]
    assert torch.allclose(by_turns.motion[:2], register(frames[:2]).motion, atol=0.2)
    assert by_turns.messages[0] == "frame 2 is the same as frame 0: left out"
    copies = register(frames[:1].expand(4, -1, -1))
    assert (copies.motion - torch.eye(3)).abs().max() == 0


def test_repeated_frames_do_not_lower_the_noise(burst):
    once, thrice = (deepir.run("nuc", "prior=tv", frames=burst.frames.repeat(times, 0), threads=1) for times in (1, 3))
    assert abs(thrice.metrics["noise_sigma"] / once.metrics["noise_sigma"] - 1) < 1e-3


def test_frames_that_share_nothing_cost_a_bounded_number_of_alignments(monkeypatch):
    calls, align = [], frame_selection.align
    monkeypatch.setattr(frame_selection, "align", lambda *given: calls.append(len(given[1])) or align(*given))
    generator = torch.Generator().manual_seed(0)
    found = register(torch.rand(16, 48, 64, generator=generator))
    assert found.used.sum() == 1
    assert "frame 1 does not register" in found.messages[0]
    assert len(calls) < 50
    calls.clear()
    noise = torch.rand(160, 32, 40, generator=generator)
    level = frame_selection.Level(1, noise - 0.5, torch.ones(32, 40), True, (32, 40))
    used, _ = frame_selection.reject_frames(
        level, noise.new_ones(160).bool(), torch.eye(3).double().repeat(160, 1, 1), "shift"
    )
    assert used.sum() < 4
    assert calls[1] == 155  # several are rejected at a time
    assert len(calls) < 110


def lost_bands(shape, seed):
    """Half of the frames lack 10 to 50 of their rows."""
    rng, valid = np.random.default_rng(seed), np.ones(shape, bool)
    for k in range(0, shape[0], 2):
        height = rng.integers(10, 50)
        top = rng.integers(0, shape[1] - height)
        valid[k, top : top + height] = False
    return valid


def masked(frames, valid):
    """The registration of frames whose samples outside of `valid` are lost."""
    valid = torch.from_numpy(valid)
    return register(fill_nearest((frames * valid)[:, None], valid[:, None])[:, 0], valid=valid)


@pytest.mark.parametrize("camera", [TONES, TONES_IN_COUNTS], ids=["tones", "counts"])
@pytest.mark.parametrize(("seed", "n_frames"), [(1, 3), (3, 5)])
def test_frames_that_lack_a_band_register(seed, n_frames, camera):
    sim, frames = recorded(f"drawn {seed}", seed, n_frames=n_frames, **camera)
    found = masked(frames, lost_bands(sim.frames.shape, seed))
    assert found.used.all()
    assert errors(found, sim.truth.motion, frames.shape[1:]).max() < 0.3


def test_a_masked_object_does_not_bias_the_motion():
    sim, frames = recorded("drawn 2", 61, walker=0.7, walker_contrast=0.5, **TONES)
    assert errors(masked(frames, ~sim.truth.moving), sim.truth.motion, frames.shape[1:]).max() < 0.15


def test_frames_without_lost_samples_are_registered_as_they_are():
    _, frames = recorded("drawn 5", 7, n_frames=3, **TONES)
    whole = register(frames, valid=torch.ones_like(frames, dtype=torch.bool))
    assert torch.equal(whole.motion, register(frames).motion)


def test_a_hole_is_filled_from_around_it_and_a_frame_from_its_one_good_pixel():
    rows = torch.arange(40.0)[:, None].expand(40, 50)
    good = torch.ones(40, 50, dtype=torch.bool)
    good[10:30, 20:40] = good[3, 3] = False
    found = fill_bad_pixels(rows[None], good)[0]
    assert torch.equal(found[good].float(), rows[good])
    assert float((found - rows)[~good].abs().max()) < 12
    assert float(found[3, 3]) == pytest.approx(3)
    one = rows == rows[7, 0]
    assert torch.allclose(fill_bad_pixels(rows[None], one & (torch.arange(50) == 9)).float(), rows[7, 0])
