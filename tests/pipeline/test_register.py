"""What is reported of how frames move; frames that follow each other in time may not be missing."""

import dataclasses

import numpy as np
import pytest
import torch

import deepir
from deepir.errors import ConfigError
from deepir.pipeline.register import _along_a_line, _places, _spans
from deepir.pipeline.schedule import demand_order, interpolate_missing_motion, interpolation_message
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


def test_a_rotation_about_a_corner_moves_the_others():
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


@pytest.mark.parametrize("select", [None, 8, "8", "2:10", "3:", [4, 5, 6], ":-1"])
def test_frames_one_after_the_other_are_fine(select):
    demand_order(select, "deblur_lag")


@pytest.mark.parametrize("select", ["::2", [0, 2, 4], "10:2:-1", [3, 2, 1]])
def test_a_selection_with_gaps_is_refused(select):
    with pytest.raises(ConfigError, match="'deblur_lag' needs frames that follow each other in time"):
        demand_order(select, "deblur_lag")


def test_a_frame_in_between_is_taken_with_a_motion_in_between():
    motion = torch.eye(3, dtype=torch.float64).repeat(6, 1, 1)
    motion[:, 0, 2] = torch.tensor([np.nan, 0.0, 1.0, np.nan, 3.0, np.nan])
    used = np.array([0, 1, 1, 0, 1, 0], bool)
    filled, taken = interpolate_missing_motion(motion, used)
    assert taken.tolist() == [False, True, True, True, True, False]
    assert filled[1:5, 0, 2].tolist() == [0, 1, 2, 3]
    (message,) = interpolation_message(used, taken)
    assert message.startswith("frame 3 is bridged")
