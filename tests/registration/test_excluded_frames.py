"""Frames that show nothing new are left out: repeated ones, and those of a closed shutter."""

import numpy as np
import pytest
import torch
from registered import camera_of_tones, simulated

import deepir
from deepir.registration import register
from deepir.simulate import simulate
from deepir.simulate.scenes.procedural import procedural, sky

COUNTS = {"counts": True, "photons": 0.0, "read_noise": 0.003}
SCENES = {
    "people": procedural(3, (430, 500)),
    "texture": procedural(5, (430, 500)),
    "sky": sky(2, (430, 500)),
}


def burst(scene, shut=(), seed=4):
    """Frames, some of which are of a closed shutter."""
    sim = simulate(SCENES[scene], camera_of_tones(n_frames=7, **COUNTS), seed=seed)
    frames, rng = sim.frames.astype(np.float64), np.random.default_rng(seed)
    level = float(frames.mean()) / float(np.mean(sim.truth.gain)) - float(np.mean(sim.truth.offset))
    for k in shut:
        pattern = sim.truth.gain * level + sim.truth.offset
        frames[k] = np.round(pattern + 3 * rng.normal(size=pattern.shape))
    return torch.from_numpy(frames.astype(np.float32))


@pytest.mark.parametrize("shut", [(0,), (3,), (6,), (2, 3), (0, 1, 2)])
@pytest.mark.parametrize("scene", ["people", "texture"])
def test_frames_of_a_closed_shutter_are_left_out(scene, shut):
    frames = burst(scene, shut)
    result = register(frames)
    assert (~result.used).nonzero()[:, 0].tolist() == list(shut)
    said = [message for message in result.messages if "shutter" in message]
    assert [int(message.split()[1]) for message in said] == list(shut)
    others = result.used.numpy()
    alone = register(frames[others])
    assert torch.allclose(result.motion[others], alone.motion, atol=0.02)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("scene", SCENES)
def test_frames_of_a_scene_are_not(scene, seed):
    frames = burst(scene, seed=seed)
    assert register(frames).used.all()


def test_frames_that_are_read_twice_are_used_once():
    frames, _ = simulated("camera", n_frames=4)
    once, twice = register(frames), register(frames.repeat_interleave(2, 0))
    assert twice.used.tolist() == [True, False] * 4
    assert torch.allclose(twice.motion[::2], once.motion, atol=1e-6)
    assert twice.messages == [f"frame {k} is the same as the one before it: left out" for k in (1, 3, 5, 7)]


def test_two_views_by_turns_are_two_frames():
    frames, _ = simulated("camera", n_frames=4)
    once, by_turns = register(frames[:2]), register(frames[[0, 1, 0, 1, 0]])
    assert by_turns.used.tolist() == [True, True, False, False, False]
    assert torch.allclose(by_turns.motion[:2], once.motion, atol=0.2)
    assert by_turns.messages[0] == "frame 2 is the same as frame 0: left out"


def test_repeated_frames_do_not_lower_the_noise():
    frames = simulated("camera", n_frames=4)[0].numpy()
    once, thrice = (deepir.run("nuc", frames=frames.repeat(times, 0), threads=1) for times in (1, 3))
    assert abs(thrice.metrics["noise_sigma"] / once.metrics["noise_sigma"] - 1) < 1e-3


def test_a_burst_of_copies_alone_does_not_move():
    frames, _ = simulated("camera", n_frames=4)
    result = register(frames[:1].expand(4, -1, -1))
    assert (result.motion - torch.eye(3)).abs().max() == 0
