"""Between the frames the camera goes on smoothly."""

import pytest
import torch

from deepir.operators.base import Trajectory


def test_one_instant_a_frame_is_the_frames_own():
    motion = torch.rand(4, 3, 3)
    assert Trajectory().interpolate(motion) is motion


@pytest.mark.parametrize("path", [Trajectory(4), Trajectory(3, n_before=2)])
@pytest.mark.parametrize("n_frames", [1, 2, 3, 7])
def test_the_path_goes_through_the_frames(path, n_frames):
    motion = torch.rand(n_frames, 3, 3, dtype=torch.float64)
    instants = path.interpolate(motion)
    assert len(instants) == path.count(n_frames)
    assert path.frames(len(instants)) == n_frames
    assert torch.allclose(instants[path.n_before :: path.steps], motion, atol=1e-12)


def test_a_cubic_path_is_found_exactly_and_goes_on_before_the_first_frame():
    def place(time):
        return torch.stack((1 + time**3, 2 * time - time**2), -1)

    path = Trajectory(5, n_before=5)
    found = path.interpolate(place(torch.arange(6, dtype=torch.float64)))
    assert torch.allclose(found, place(torch.arange(-5, 26, dtype=torch.float64) / 5), atol=1e-10)
