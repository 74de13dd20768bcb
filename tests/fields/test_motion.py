"""Motion models."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepir.fields.motion import Affine, Auto, Homography, Rigid, Shift

MODELS = [Shift, Rigid, Affine, Homography]
each_model = pytest.mark.parametrize("model", MODELS)


def make(model, n_frames=3):
    return model((n_frames, 3, 3), size=(60, 80)).double()


@each_model
@settings(max_examples=30, deadline=None)
@given(data=st.data())
def test_parameters_and_matrices_are_inverse(model, data):
    field = make(model)
    numbers = st.lists(st.floats(-10, 10), min_size=model.n_parameters, max_size=model.n_parameters)
    p = torch.tensor([data.draw(numbers)], dtype=torch.float64)
    t = field.matrices(p)
    assert (t[:, 2, 2] == 1).all()
    assert torch.allclose(field.parameters_of(t), p, atol=1e-9)


@each_model
def test_a_parameter_of_one_moves_the_frames_edge_by_about_a_pixel(model):
    field = make(model)
    corner = torch.tensor([39.5, 29.5, 1.0], dtype=torch.float64)
    for i in range(model.n_parameters):
        p = torch.zeros(1, model.n_parameters, dtype=torch.float64)
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
