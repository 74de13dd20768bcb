"""A warp whose motion is given as the points at which pixels look."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from deepir.operators import Warp
from deepir.operators.bspline import sample
from deepir.operators.warp import project_pixels
from deepir.testing import check_operator

seeds = st.integers(0, 999)


def bent(size, n_frames=3, shift=2.0, seed=0):
    """Points that no homography gives, (N, h, w, 2) float64."""
    generator = torch.Generator().manual_seed(seed)
    still = project_pixels(torch.eye(3, dtype=torch.float64)[None], size)
    away = torch.rand(n_frames, *size, 2, generator=generator, dtype=torch.float64) - 0.5
    return still + 2 * shift * away


class OnPoints(Warp):
    """A warp that says that its motion is points, as the checks of operators want."""

    def slots(self, x_shape, n_frames):
        return {"motion": (n_frames, *self.size, 2)}


def test_it_is_exact_with_exact_adjoint_and_gradients():
    operator, x = OnPoints((6, 7), (11, 12), (2, 3)), torch.rand(1, 1, 11, 12, dtype=torch.float64)

    def reference(x, slots):
        away = ((11 - 1) / 2, (12 - 1) / 2)  # the canvas' centre
        shift = (2 + 5 / 2 - away[0], 3 + 6 / 2 - away[1])  # of the frame's centre from it
        at = [slots["motion"][..., 1] + shift[0] + away[0], slots["motion"][..., 0] + shift[1] + away[1]]
        inside = [np.clip(each, 1, side - 2) for each, side in zip(at, (11, 12), strict=True)]
        found = [ndimage.map_coordinates(x[0, 0], each, order=3, prefilter=False) for each in zip(*inside, strict=True)]
        return np.stack(found)[:, None]

    check_operator(operator, x, {"motion": bent((6, 7))}, reference=reference)


@settings(max_examples=40, deadline=None)
@given(
    size=st.tuples(st.integers(1, 9), st.integers(1, 40)), canvas=st.tuples(st.integers(4, 12), st.integers(4, 12)),
    channels=st.integers(1, 2), scenes=st.sampled_from([1, 3]), shift=st.sampled_from([0.3, 30.0]), seed=seeds,
)  # fmt: skip
def test_frames_adjoint_and_gradient_are_those_of_other_devices(size, canvas, channels, scenes, shift, seed):
    operator = Warp(size, canvas, (1, -1))
    x = torch.rand(scenes, channels, *canvas, dtype=torch.float64, requires_grad=True)
    motion = bent(size, 3, shift, seed).requires_grad_()
    wanted, found = sample(x, operator.sampling_points(motion)), operator(x, motion=motion)
    assert torch.allclose(found, wanted, atol=1e-9)
    weights = torch.rand(found.shape, dtype=found.dtype, generator=torch.Generator().manual_seed(1))
    mine, theirs = (torch.autograd.grad(each, (x, motion), weights) for each in (found, wanted))
    for one, other in zip(mine, theirs, strict=True):
        assert torch.allclose(one, other, rtol=1e-6, atol=1e-8 * float(other.abs().max()))


def test_the_result_does_not_depend_on_the_number_of_threads():
    operator, motion = Warp((9, 11), (13, 15), (2, 2)), bent((9, 11)).requires_grad_()
    x, found, before = torch.rand(1, 1, 13, 15, requires_grad=True), [], torch.get_num_threads()
    try:
        for threads in (1, 2, 7):
            torch.set_num_threads(threads)
            y = operator(x, motion=motion)
            found.append((y, *torch.autograd.grad(y.square().sum(), (x, motion))))
    finally:
        torch.set_num_threads(before)
    for each in found[1:]:
        assert all(torch.equal(a, b) for a, b in zip(each, found[0], strict=True))


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -1e30])
def test_a_point_that_is_not_a_number_gives_numbers_and_gradients(bad):
    operator, x = Warp((6, 7), (11, 12), (2, 3)), torch.rand(1, 1, 11, 12, requires_grad=True)
    motion = bent((6, 7)).float()
    motion[1, 2, 3] = bad
    motion.requires_grad_()
    y = operator(x, motion=motion)
    assert y.isfinite().all()
    assert all(g.isfinite().all() for g in torch.autograd.grad(y.sum(), (x, motion)))


def test_a_sample_is_valid_where_its_coefficients_lie_in_the_canvas():
    operator, motion = Warp((6, 7), (11, 12), (2, 3)), bent((6, 7), shift=6.0)
    points = operator.sampling_points(motion)
    inside = (points[..., 0].abs() <= 4.5) & (points[..., 1].abs() <= 4)
    assert torch.equal(operator.valid(torch.ones(1, 1, 11, 12), motion=motion)[:, 0] > 0, inside)
