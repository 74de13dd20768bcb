"""Dense motion as a field."""

import pytest
import torch

from deepir.fields.motion import Flow
from deepir.operators.motion_models import displacement_at, displacements, homographies
from deepir.operators.warp import project_pixels

SIZE = (40, 50)


def make(n_frames=3, **options):
    return Flow((n_frames, 3, 3), size=SIZE, **options).double()


def tilted(n_frames=3):
    """Homographies of all eight degrees of freedom; the first is the identity."""
    motion = torch.eye(3, dtype=torch.float64).repeat(n_frames, 1, 1)
    generator = torch.Generator().manual_seed(0)
    motion[1:, :2] += 0.02 * torch.randn(n_frames - 1, 2, 3, generator=generator, dtype=torch.float64)
    motion[1:, 2, :2] = 1e-4 * torch.randn(n_frames - 1, 2, generator=generator, dtype=torch.float64)
    motion[1:, :2, 2] *= 100
    return motion


def test_it_starts_at_homographies_without_displacements():
    field, motion = make(), tilted()
    field.init_from(motion)
    assert torch.allclose(field(), project_pixels(motion, SIZE))
    assert field.penalty() == 0


def test_the_first_frame_and_a_single_one_never_move():
    field = make()
    field.values.data.normal_()
    assert torch.equal(field()[0], project_pixels(torch.eye(3, dtype=torch.float64)[None], SIZE)[0])
    assert make(1)().shape == (1, *SIZE, 2)
    assert make(1).values.numel() == 0


def test_a_cubic_is_represented_exactly_and_so_is_what_a_coarser_grid_can():
    field = make(spacing=8)
    y, x = (torch.arange(side, dtype=torch.float64) / side for side in SIZE)
    bent = torch.stack((x**3 - x * y[:, None], y[:, None] ** 2 * x), -1)
    wanted = field().detach().clone()
    wanted[1] += 3 * bent
    field.init_from(wanted)
    assert torch.allclose(field(), wanted, atol=1e-5)
    field.values.data.normal_()
    finer = make(spacing=4)
    finer.init_from(field().detach())
    assert torch.allclose(finer(), field(), atol=1e-5)


def test_a_step_costs_its_height_times_its_length_whatever_the_spacing():
    costs = []
    for spacing in (4.0, 2.0):
        field = make(2, spacing=spacing, weight=2.0)
        columns = field.values.shape[-1]
        field.values.data[:, 0, :, columns // 2 :] = 5 / field.preconditioning_scale
        costs.append(float(field.penalty().detach()) / (2.0 * 5 * spacing * field.values.shape[-2]))
    assert costs == pytest.approx([1, 1], rel=0.02)


def test_spacings_and_weights_that_make_no_sense_are_refused():
    with pytest.raises(ValueError, match="spacing must be 2 to 1000 px"):
        make(spacing=1)
    with pytest.raises(ValueError, match="at least 0"):
        make(weight=-1)


def test_points_and_homographies_displace_alike():
    motion, at = tilted(), torch.tensor([10.5, -7.5], dtype=torch.float64)  # a pixel's centre
    points = project_pixels(motion, SIZE)
    assert torch.allclose(homographies(points), motion, atol=1e-9)
    assert homographies(motion) is motion
    assert torch.allclose(displacement_at(points, at), displacement_at(motion, at))
    assert torch.allclose(displacements(points)[:, :, 12, 35], displacement_at(motion, at))
