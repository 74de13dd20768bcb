"""What is said of how frames move."""

import dataclasses

import torch

import deepir
from deepir.pipeline.register import _along_a_line, _places, _spans
from deepir.registration import register
from deepir.simulate import Settings, simulate


def test_a_burst_that_moves_along_a_slanted_line_is_warned_of():
    line = shifted([[0.0, 0.0], [-10.0, -7.2], [-7.8, -5.8]])
    (message,) = _along_a_line(_places(line, (120, 160)))
    assert message.startswith("the frames move along one line, by 12.3 px")
    assert _along_a_line(_places(shifted([[0.0, 0.0], [5.0, 5.0], [5.0, -4.0]]), (120, 160))) == []


def test_a_burst_that_only_turns_about_a_point_is_warned_of_as_such():
    angles = torch.tensor([0.0, 0.05, -0.03, 0.02], dtype=torch.float64)
    turned = torch.eye(3, dtype=torch.float64).repeat(4, 1, 1)
    turned[:, 0, 0] = turned[:, 1, 1] = angles.cos()
    turned[:, 0, 1], turned[:, 1, 0] = -angles.sin(), angles.sin()
    (message,) = _along_a_line(_places(turned, (120, 160)))
    assert message.startswith("the frames turn about one point, by 8.0 px at their corners, and do not move")
    shaken = turned + shifted([[0.0, 0.0], [5.0, 5.0], [5.0, -4.0], [-3.0, 4.0]]) - torch.eye(3)
    assert _along_a_line(_places(shaken, (120, 160))) == []


def test_what_turns_about_a_corner_moves_elsewhere():
    turned = torch.eye(3, dtype=torch.float64).repeat(2, 1, 1)
    turned[1, 0, 1], turned[1, 1, 0] = -0.05, 0.05
    turned[1, :2, 2] = -turned[1, :2, :2] @ torch.tensor([80.0, 60.0]).double() + torch.tensor([80.0, 60.0])
    assert _spans(turned, (120, 160)).min() > 5


def test_small_motion_is_that_of_the_result_not_of_the_registration(monkeypatch):
    camera = Settings(n_frames=4, shape=(48, 56), counts=True, max_shift=2.8, motion="shift")
    frames = simulate(None, camera, seed=2).frames  # they move by 3.3 px along x, 4.2 px along y

    def too_small(frames, **options):
        found = register(frames, **options)
        return dataclasses.replace(found, motion=found.motion.lerp(torch.eye(3).double(), 0.3))

    monkeypatch.setattr("deepir.pipeline.register.register", too_small)
    registered, refined = (
        " ".join(deepir.run("nuc", f"method={method}", frames=frames, threads=1).messages)
        for method in ("average", "joint")
    )
    assert "the frames move by only 2.4 px along x" in registered
    assert "the frames move by only" not in refined


def shifted(by):
    """Motion (N, 3, 3) of frames that look `by` px (N, 2) aside."""
    motion = torch.eye(3, dtype=torch.float64).repeat(len(by), 1, 1)
    motion[:, :2, 2] = torch.tensor(by)
    return motion
