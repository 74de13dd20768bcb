"""Frames that go on from each other may not be missing."""

import numpy as np
import pytest
import torch

from deepir.errors import ConfigError
from deepir.pipeline.schedule import demand_order, interpolate_missing_motion, interpolation_message


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
