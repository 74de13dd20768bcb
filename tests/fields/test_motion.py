"""Motion models, and dense motion."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepir.fields.motion import Affine, Auto, Flow, Homography, Rigid, Shift
from deepir.operators.motion_models import displacement_at, displacements, homographies
from deepir.operators.warp import project_pixels

SIZE = (40, 50)  # of dense motion
MODELS = [Shift, Rigid, Affine, Homography]
each_model = pytest.mark.parametrize("model", MODELS)


def make(model, n_frames=3):
    return model((n_frames, 3, 3), size=(60, 80)).double()


@each_model
@settings(max_examples=30, deadline=None)
@given(data=st.data())
def test_parameters_and_matrices_are_inverse(model, data):
    field = make(model)
    numbers = st.lists(st.floats(-10, 10), min_size=field.n_parameters, max_size=field.n_parameters)
    p = torch.tensor([data.draw(numbers)], dtype=torch.float64)
    t = field.matrices(p)
    assert (t[:, 2, 2] == 1).all()
    assert torch.allclose(field.parameters_of(t), p, atol=1e-9)


@each_model
def test_a_parameter_of_one_moves_the_frames_edge_by_about_a_pixel(model):
    field = make(model)
    corner = torch.tensor([39.5, 29.5, 1.0], dtype=torch.float64)
    for i in range(field.n_parameters):
        p = torch.zeros(1, field.n_parameters, dtype=torch.float64)
        p[0, i] = 1
        x, y, z = field.matrices(p)[0] @ corner
        moved = torch.hypot(x / z - corner[0], y / z - corner[1])
        assert 0.3 < moved < 1.2


def test_a_model_takes_what_it_can_of_a_motion():
    t = torch.eye(3, dtype=torch.float64).repeat(2, 1, 1)
    t[1, :2] = torch.tensor([[1.01, -0.02, 3], [0.02, 1.01, -4]])
    field = make(Rigid, 2)
    field.init_from(t)
    found = field().detach()[1]
    assert torch.allclose(found[:2, 2], t[1, :2, 2])
    assert torch.allclose(found[:2, :2] @ found[:2, :2].T, torch.eye(2, dtype=torch.float64))
    assert torch.atan2(found[1, 0], found[0, 0]) == pytest.approx(0.02 / 1.01, rel=1e-3)
    field = make(Affine, 2)
    field.init_from(t)
    assert torch.allclose(field(), t)


@each_model
def test_a_single_frame_does_not_move(model):
    field = make(model, 1)
    assert torch.equal(field(), torch.eye(3, dtype=torch.float64)[None])


def test_auto_keeps_a_rigid_motion_rigid_and_follows_one_that_bends():
    field = Auto((2, 3, 3), size=(60, 80))
    turned = torch.eye(3, dtype=torch.float64).repeat(2, 1, 1)
    turned[1, :2, :2] = torch.tensor([[math.cos(0.1), -math.sin(0.1)], [math.sin(0.1), math.cos(0.1)]])
    field.init_from(turned)
    with torch.no_grad():
        field.values.normal_()
    linear = field()[1, :2, :2]
    assert torch.allclose(linear @ linear.T, torch.eye(2), atol=1e-6)
    tilted = turned.clone()
    tilted[1, 2, 0] = 1e-5  # 0.025 px at the corners
    field.init_from(tilted)
    assert torch.allclose(field().double(), tilted, atol=1e-6)


def flow(n_frames=3, **options):
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
    field, motion = flow(), tilted()
    field.init_from(motion)
    assert torch.allclose(field(), project_pixels(motion, SIZE))
    assert field.penalty() == 0


def test_the_first_frame_and_a_single_one_never_move():
    field = flow()
    field.values.data.normal_()
    assert torch.equal(field()[0], project_pixels(torch.eye(3, dtype=torch.float64)[None], SIZE)[0])
    assert flow(1)().shape == (1, *SIZE, 2)
    assert flow(1).values.numel() == 0


def test_a_cubic_is_represented_exactly_and_so_is_what_a_coarser_grid_can():
    field = flow(spacing=8)
    y, x = (torch.arange(side, dtype=torch.float64) / side for side in SIZE)
    bent = torch.stack((x**3 - x * y[:, None], y[:, None] ** 2 * x), -1)
    wanted = field().detach().clone()
    wanted[1] += 3 * bent
    field.init_from(wanted)
    assert torch.allclose(field(), wanted, atol=1e-5)
    field.values.data.normal_()
    finer = flow(spacing=4)
    finer.init_from(field().detach())
    assert torch.allclose(finer(), field(), atol=1e-5)


def test_a_step_costs_its_height_times_its_length_whatever_the_spacing():
    costs = []
    for spacing in (4.0, 2.0):
        field = flow(2, spacing=spacing, weight=2.0)
        columns = field.values.shape[-1]
        field.values.data[:, 0, :, columns // 2 :] = 5 / field.preconditioning_scale
        costs.append(float(field.penalty().detach()) / (2.0 * 5 * spacing * field.values.shape[-2]))
    assert costs == pytest.approx([1, 1], rel=0.02)


def test_spacings_and_weights_that_make_no_sense_are_refused():
    with pytest.raises(ValueError, match="spacing must be 2 to 1000 px"):
        flow(spacing=1)
    with pytest.raises(ValueError, match="at least 0"):
        flow(weight=-1)


def test_points_and_homographies_displace_alike():
    motion, at = tilted(), torch.tensor([10.5, -7.5], dtype=torch.float64)  # a pixel's centre
    points = project_pixels(motion, SIZE)
    assert torch.allclose(homographies(points), motion, atol=1e-9)
    assert homographies(motion) is motion
    assert torch.allclose(displacement_at(points, at), displacement_at(motion, at))
    assert torch.allclose(displacements(points)[:, :, 12, 35], displacement_at(motion, at))
