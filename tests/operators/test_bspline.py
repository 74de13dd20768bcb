"""The compiled warp is the spline that other devices compute, with its gradients, only more exact."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from deepir.kernels.bspline import grad_homography, warp, warp_adjoint
from deepir.operators import Warp
from deepir.operators.bspline import sample

SIZE, CANVAS, ORIGIN = (9, 11), (13, 15), (2, 2)
seeds, sides = st.integers(0, 999), st.integers(4, 12)


def motions(n, angle=0.1, shift=2.0, tilt=0.01, seed=0):
    """Rotations up to `angle`, shifts, and a horizon: a tilt of 0.2 puts part of a frame behind the camera."""
    t = torch.Generator().manual_seed(seed)
    a, s, k = (2 * torch.rand(n, m, generator=t, dtype=torch.float64) - 1 for m in (1, 2, 2))
    motion = torch.eye(3, dtype=torch.float64).repeat(n, 1, 1)
    cos, sin = (angle * a).cos(), (angle * a).sin()
    motion[:, :2, :2] = torch.cat((cos, -sin, sin, cos), 1).reshape(n, 2, 2)
    motion[:, :2, 2], motion[:, 2, :2] = shift * s, tilt * k
    return motion


def by_torch(operator, x, motion):
    """As on other devices."""
    return sample(x, operator.sampling_points(motion).to(x.dtype))


def gradients(warped, *of):
    weights = torch.rand(warped.shape, dtype=warped.dtype, generator=torch.Generator().manual_seed(1))
    return torch.autograd.grad(warped, of, weights)


@settings(max_examples=100, deadline=None)
@given(
    size=st.tuples(st.integers(1, 9), st.integers(1, 40)), canvas=st.tuples(sides, sides), channels=st.integers(1, 2),
    scenes=st.sampled_from([1, 3]), angle=st.sampled_from([0.0, 0.05, math.pi]),
    shift=st.sampled_from([0.0, 1.0, 30.0]), tilt=st.sampled_from([0.0, 0.01, 0.2]), seed=seeds,
)  # fmt: skip
def test_frames_adjoint_and_gradient_are_those_of_other_devices(
    size, canvas, channels, scenes, angle, shift, tilt, seed
):
    operator = Warp(size, canvas, (1, -1))
    x = torch.rand(scenes, channels, *canvas, dtype=torch.float64, requires_grad=True)
    # Jitter: no sample on the outermost pixel but one, where the gradient in the motion jumps.
    motion = motions(3, angle, shift, tilt, seed) + 0.01 * torch.rand(3, 3, 3, dtype=torch.float64)
    motion.requires_grad_()
    wanted, found = by_torch(operator, x, motion), operator(x, motion=motion)
    assert torch.allclose(found, wanted, atol=1e-9)
    for mine, theirs in zip(gradients(found, x, motion), gradients(wanted, x, motion), strict=True):
        assert torch.allclose(mine, theirs, rtol=1e-6, atol=1e-8 * float(theirs.abs().max()))


def test_in_float32_it_is_as_exact_as_the_type():
    operator = Warp((100, 640), (120, 700), (10, 30))
    x, motion = torch.rand(1, 1, 120, 700), motions(3, 0.01, 5.0, 1e-6)
    wanted = by_torch(operator, x.double(), motion)
    errors = [
        float((each - wanted).abs().max()) for each in (operator(x, motion=motion), by_torch(operator, x, motion))
    ]
    assert errors[0] < 3e-7
    assert errors[0] < errors[1] / 10  # whose coordinates are in float32


@settings(max_examples=20, deadline=None)
@given(angle=st.sampled_from([0.0, 0.1, 1.5]), tilt=st.sampled_from([0.0, 0.2]), seed=seeds)
def test_the_result_does_not_depend_on_the_number_of_threads(angle, tilt, seed):
    operator, motion = Warp(SIZE, CANVAS, ORIGIN), motions(3, angle, 3.0, tilt, seed).requires_grad_()
    x, found, before = torch.rand(1, 1, *CANVAS, requires_grad=True), [], torch.get_num_threads()
    try:
        for threads in (1, 2, 7, 20):
            torch.set_num_threads(threads)
            y = operator(x, motion=motion)
            found.append((y, *gradients(y, x, motion)))
    finally:
        torch.set_num_threads(before)
    for other in found[1:]:
        assert all(torch.equal(a, b) for a, b in zip(found[0], other, strict=True))


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -float("inf"), 1e300, 0.0])
def test_no_motion_whatsoever_reads_or_writes_outside_the_canvas(bad):
    scene, gradient = np.ones((1, 1, *CANVAS)), np.ones((2, 1, *SIZE))
    for entry in np.ndindex(3, 3):
        motion = motions(2).numpy()
        motion[1][entry] = bad
        out, guarded, sums = (
            np.empty((2, 1, *SIZE)),
            np.full((3, 1, *CANVAS), 7.0),
            np.zeros((2, SIZE[0], 3, 2)),
        )
        warp(0, SIZE[0], scene, motion, out)
        guarded[1] = 0
        warp_adjoint(0, CANVAS[0], gradient, motion, guarded[1:2])
        grad_homography(0, SIZE[0], gradient, scene, motion, sums)
        assert out[0] == pytest.approx(1)
        assert (guarded[[0, 2]] == 7).all()


def test_scenes_that_are_neither_one_nor_one_a_frame_are_refused():
    operator, x, slots = Warp.example()
    with pytest.raises(ValueError, match="2 scenes for 3 frames"):
        operator(x.expand(2, -1, -1, -1), **slots)


def test_a_canvas_too_small_for_a_spline_is_refused():
    with pytest.raises(ValueError, match="less than 4"):
        Warp((3, 4), (5, 3), (1, 0))


@settings(max_examples=30, deadline=None)
@given(seed=seeds, angle=st.sampled_from([0.0, 0.1]), shift=st.sampled_from([0.0, 1.0]))
def test_frames_are_those_of_scipys_spline_interpolation_of_the_image(seed, angle, shift):
    # An image that is the same beyond the edges of the canvas: there the two differ in what they take for granted.
    operator, motion = Warp((8, 9), (28, 30), (10, 10)), motions(2, angle, shift, 1e-3, seed)
    x = torch.zeros(1, 1, 28, 30, dtype=torch.float64)
    x[..., 8:-8, 8:-8] = torch.rand(12, 14, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    y, x_ = np.meshgrid(np.arange(8) - 3.5, np.arange(9) - 4.0, indexing="ij")
    at = np.einsum("nij,jhw->nihw", motion.numpy(), np.stack([x_, y, np.ones_like(y)]))
    rows, columns = at[:, 1] / at[:, 2] + 13.5, at[:, 0] / at[:, 2] + 14.0
    wanted = ndimage.map_coordinates(operator.to_pixels(x)[0, 0].numpy(), [rows, columns], order=3, mode="mirror")
    assert operator(x, motion=motion)[:, 0].numpy() == pytest.approx(wanted, abs=1e-10)


def test_white_noise_of_an_image_is_so_much_stronger_in_its_coefficients():
    noise = np.random.default_rng(0).standard_normal((512, 512))
    coefficients = ndimage.spline_filter(noise, 3, mode="mirror")
    assert coefficients.std() == pytest.approx(Warp.noise_gain, rel=0.02)
