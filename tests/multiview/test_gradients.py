"""The pattern that frames share at the edges of their pixels, and how it is solved for."""

import pytest
import torch

from deepir.closed_form.conjugate_gradient import conjugate_gradient
from deepir.closed_form.variable_projection import COLUMN, PIXEL, ROW
from deepir.multiview.gradients import SHARE, Edges, likeliest_tail

SIZE = (9, 11)


@pytest.fixture
def edges():
    """Five frames of 9 x 11 px, one pixel of which does not count."""
    frames = torch.randn(5, *SIZE, dtype=torch.float64) + torch.linspace(0, 3, 5)[:, None, None]
    usable = torch.ones_like(frames, dtype=torch.bool)
    usable[:, 4, 5] = False
    return Edges(frames, usable, frames.median(0).values)


def matrix(edges):
    """The normal matrix, column by column."""
    one = torch.eye(2 * SIZE[0] * SIZE[1], dtype=torch.float64)
    return torch.stack([edges.normal(each.view(2, *SIZE)).flatten() for each in one], 1)


def test_the_normal_equations_are_those_of_weighted_least_squares(edges):
    pattern = 0.1 * torch.randn(2, *SIZE, dtype=torch.float64)
    other = torch.randn(2, *SIZE, dtype=torch.float64)
    scales, doubts = edges.scales.clone(), [each.clone() for each in edges.doubt]
    edges.weigh(pattern)
    nats, slope = 0.0, 0.0
    for k, frame in enumerate(edges.frames):
        parts = []
        for axis, doubt in zip((-1, -2), doubts, strict=True):
            ahead, here = (each.narrow(axis, i, SIZE[axis] - 1) for each in (frame,) for i in (1, 0))
            counts = edges.usable[k].narrow(axis, 1, SIZE[axis] - 1) & edges.usable[k].narrow(axis, 0, SIZE[axis] - 1)
            level = (ahead + here) / 2 - edges.level
            square = (ahead - here - pattern[1].diff(dim=axis) - level * pattern[0].diff(dim=axis)) ** 2 + doubt
            parts.append((axis, ahead - here, level, square, counts))
        squares = torch.cat([square[counts] for *_, square, counts in parts])
        freedom, scale = likeliest_tail(squares, float(scales[k]))
        for axis, step, level, square, counts in parts:
            weight = (freedom + 1) * SHARE * counts / (freedom * scale + square)
            of_other = other[1].diff(dim=axis) + level * other[0].diff(dim=axis)
            nats += (weight * of_other**2).sum()
            slope += (weight * of_other * step).sum()
    assert torch.allclose((other * edges.normal(other)).sum(), nats)
    assert torch.allclose((other * edges.score()).sum(), slope)


def test_the_normal_matrix_is_symmetric_and_semidefinite(edges):
    whole = matrix(edges)
    assert torch.allclose(whole, whole.T)
    assert torch.linalg.eigvalsh(whole).min() > -1e-9


@pytest.mark.parametrize("along", [PIXEL, COLUMN, ROW])
def test_information_is_the_diagonal_of_the_normal_matrix(edges, along):
    whole = matrix(edges).view(2, *SIZE, 2, *SIZE)
    maps = torch.eye(SIZE[0] * SIZE[1], dtype=torch.float64).view(-1, *SIZE)
    if along:
        axis = along[0]
        side = SIZE[1] if axis == -2 else SIZE[0]
        maps = torch.eye(side, dtype=torch.float64).view(-1, *((1, side) if axis == -2 else (side, 1)))
        maps = maps.expand(-1, *SIZE)
    found = torch.einsum("nab,iabjcd,ncd->ijn", maps, whole, maps)
    aa, ab, bb = edges.information(along).flatten(1)
    assert torch.allclose(found[0, 0], aa)
    assert torch.allclose(found[0, 1], ab)
    assert torch.allclose(found[1, 1], bb)


def test_the_scales_of_cauchy_gradients_are_found():
    torch.manual_seed(0)
    steps = torch.distributions.Cauchy(0.0, torch.tensor([0.5, 4.0])).sample((40, 60)).permute(2, 0, 1)
    frames = steps.double().clamp(-1e6, 1e6).cumsum(2)[:, :, :]
    edges = Edges(frames[:, :1], torch.ones(2, 1, 60, dtype=torch.bool), torch.zeros(1, 60))
    for _ in range(50):
        edges.weigh(torch.zeros(2, 1, 60, dtype=torch.float64))
        edges.doubt = [torch.zeros_like(each) for each in edges.doubt]
    assert edges.scales.sqrt().tolist() == pytest.approx([0.5, 4.0], rel=0.5)


def test_conjugate_gradients_solve_a_system():
    a = torch.randn(30, 30, dtype=torch.float64)
    a, rhs = a @ a.T / 30 + torch.eye(30), torch.randn(30, dtype=torch.float64)
    for near in (lambda x: x, lambda x: x / a.diagonal()):
        found = conjugate_gradient(
            lambda x: a @ x, rhs, torch.zeros_like(rhs), precondition=near, tolerance=1e-10, max_iterations=20
        )
        assert torch.allclose(a @ found, rhs, atol=1e-6)
