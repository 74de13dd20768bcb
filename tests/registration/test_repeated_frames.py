"""A frame that repeats the one before is left out."""

import torch
from registered import simulated

import deepir
from deepir.registration import register


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


def test_and_make_no_noise_that_is_less():
    frames = simulated("camera", n_frames=4)[0].numpy()
    once, thrice = (deepir.run("nuc", frames=frames.repeat(times, 0), threads=1) for times in (1, 3))
    assert abs(thrice.metrics["noise_sigma"] / once.metrics["noise_sigma"] - 1) < 1e-3


def test_a_burst_of_copies_alone_does_not_move():
    frames, _ = simulated("camera", n_frames=4)
    result = register(frames[:1].expand(4, -1, -1))
    assert (result.motion - torch.eye(3)).abs().max() == 0
