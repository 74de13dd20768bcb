"""The warp of homographies and of points: exact, and on the CPU the spline that other devices compute."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from deepir.kernels.bspline import grad_homography, warp, warp_adjoint
from deepir.operators import Warp
from deepir.operators.motion_models import rotation
from deepir.operators.warp import project_pixels, sample
from deepir.testing import check_operator

SIZE, CANVAS, ORIGIN = (9, 11), (13, 15), (2, 2)
seeds, sides = st.integers(0, 999), st.integers(4, 12)


def homographies(n, angle=0.1, shift=2.0, tilt=0.01, seed=0):
    """Rotations up to `angle`, shifts, and a horizon: a tilt of 0.2 puts part of a frame behind the camera."""
    t = torch.Generator().manual_seed(seed)
    a, s, k = (2 * torch.rand(n, m, generator=t, dtype=torch.float64) - 1 for m in (1, 2, 2))
    motion = rotation(angle * a[:, 0])
    motion[:, :2, 2], motion[:, 2, :2] = shift * s, tilt * k
    return motion


def points(size, n=3, shift=2.0, seed=0):
    """Points that no homography gives, (N, h, w, 2) float64."""
    still = project_pixels(torch.eye(3, dtype=torch.float64)[None], size)
    away = torch.rand(n, *size, 2, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) - 0.5
    return still + 2 * shift * away


def by_torch(operator, x, motion):
    """As on other devices."""
    return sample(x, operator.sampling_points(motion).to(x.dtype))


def gradients(warped, *of):
    weights = torch.rand(warped.shape, dtype=warped.dtype, generator=torch.Generator().manual_seed(1))
    return torch.autograd.grad(warped, of, weights)


@pytest.mark.parametrize("dense", [False, True])
@settings(max_examples=70, deadline=None)
@given(
    size=st.tuples(st.integers(1, 9), st.integers(1, 40)), canvas=st.tuples(sides, sides), channels=st.integers(1, 2),
    scenes=st.sampled_from([1, 3]), angle=st.sampled_from([0.0, 0.05, math.pi]),
    shift=st.sampled_from([0.0, 1.0, 30.0]), tilt=st.sampled_from([0.0, 0.01, 0.2]), seed=seeds,
)  # fmt: skip
def test_frames_adjoint_and_gradient_are_those_of_other_devices(
    dense, size, canvas, channels, scenes, angle, shift, tilt, seed
):
    operator = Warp(size, canvas, (1, -1))
    x = torch.rand(scenes, channels, *canvas, dtype=torch.float64, requires_grad=True)
    if dense:
        motion = points(size, 3, shift + 0.3, seed)
    else:  # jitter: no sample on the outermost pixel but one, where the gradient in the motion jumps
        motion = homographies(3, angle, shift, tilt, seed) + 0.01 * torch.rand(3, 3, 3, dtype=torch.float64)
    motion.requires_grad_()
    wanted, found = by_torch(operator, x, motion), operator(x, motion=motion)
    assert torch.allclose(found, wanted, atol=1e-9)
    for mine, theirs in zip(gradients(found, x, motion), gradients(wanted, x, motion), strict=True):
        assert torch.allclose(mine, theirs, rtol=1e-6, atol=1e-8 * float(theirs.abs().max()))


@settings(max_examples=20, deadline=None)
@given(dense=st.booleans(), angle=st.sampled_from([0.0, 0.1, 1.5]), tilt=st.sampled_from([0.0, 0.2]), seed=seeds)
def test_the_result_does_not_depend_on_the_number_of_threads(dense, angle, tilt, seed):
    operator = Warp(SIZE, CANVAS, ORIGIN)
    motion = (points(SIZE, seed=seed) if dense else homographies(3, angle, 3.0, tilt, seed)).requires_grad_()
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


def test_in_float32_it_is_as_exact_as_the_type():
    operator = Warp((100, 640), (120, 700), (10, 30))
    x, motion = torch.rand(1, 1, 120, 700), homographies(3, 0.01, 5.0, 1e-6)
    wanted = by_torch(operator, x.double(), motion)
    found = operator(x, motion=motion), by_torch(operator, x, motion)
    errors = [float((each - wanted).abs().max()) for each in found]
    assert errors[0] < 3e-7
    assert errors[0] < errors[1] / 10  # whose coordinates are in float32


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -float("inf"), 1e300, 0.0])
def test_no_motion_whatsoever_reads_or_writes_outside_the_canvas(bad):
    scene, gradient = np.ones((1, 1, *CANVAS)), np.ones((2, 1, *SIZE))
    for entry in np.ndindex(3, 3):
        motion = homographies(2).numpy()
        motion[1][entry] = bad
        out, guarded, sums = np.empty((2, 1, *SIZE)), np.full((3, 1, *CANVAS), 7.0), np.zeros((2, SIZE[0], 3, 2))
        warp(0, SIZE[0], scene, motion, out)
        guarded[1] = 0
        warp_adjoint(0, CANVAS[0], gradient, motion, guarded[1:2])
        grad_homography(0, SIZE[0], gradient, scene, motion, sums)
        assert out[0] == pytest.approx(1)
        assert (guarded[[0, 2]] == 7).all()


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -1e30])
@pytest.mark.parametrize("index", [(1, 0, 2), (1, 0, 0), (1, 2, 1), (1, 2, 3)])
def test_a_motion_that_is_not_a_number_gives_numbers_and_gradients(bad, index):
    # torch's own grid_sample takes the process down with it.
    operator, x, slots = Warp.example()
    motion = slots["motion"].clone() if max(index) < 3 else points(operator.size)
    motion[index] = bad
    motion.requires_grad_()
    x.requires_grad_()
    y = operator(x, motion=motion)
    assert y.isfinite().all()
    assert all(g.isfinite().all() for g in torch.autograd.grad(y.sum(), (x, motion)))


@settings(max_examples=30, deadline=None)
@given(seed=seeds, angle=st.sampled_from([0.0, 0.1]), shift=st.sampled_from([0.0, 1.0]))
def test_frames_are_those_of_scipys_spline_interpolation_of_the_image(seed, angle, shift):
    # An image that is the same beyond the edges of the canvas: there the two differ in what they take for granted.
    operator, motion = Warp((8, 9), (28, 30), (10, 10)), homographies(2, angle, shift, 1e-3, seed)
    x = torch.zeros(1, 1, 28, 30, dtype=torch.float64)
    x[..., 8:-8, 8:-8] = torch.rand(12, 14, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    columns, rows = (project_pixels(motion, (8, 9)) + torch.tensor([14.0, 13.5])).unbind(-1)
    wanted = ndimage.map_coordinates(operator.to_pixels(x)[0, 0].numpy(), [rows, columns], order=3, mode="mirror")
    assert operator(x, motion=motion)[:, 0].numpy() == pytest.approx(wanted, abs=1e-10)


def test_white_noise_of_an_image_is_so_much_stronger_in_its_coefficients():
    noise = np.random.default_rng(0).standard_normal((512, 512))
    coefficients = ndimage.spline_filter(noise, 3, mode="mirror")
    assert coefficients.std() == pytest.approx(Warp.noise_gain, rel=0.02)


@pytest.mark.parametrize("n_scenes", [1, 3])
@pytest.mark.parametrize("channels", [1, 2])
def test_warp_takes_one_canvas_or_one_for_each_frame_and_several_channels(n_scenes, channels):
    operator, _, slots = Warp.example()
    x = torch.rand(n_scenes, channels, 11, 12, dtype=torch.float64)
    y = operator(x, **slots)
    assert y.shape == operator.out_shape(x.shape, 3) == (3, channels, 6, 7)
    for k in range(3):
        for c in range(channels):
            each = operator(x[k if n_scenes > 1 else 0, c][None, None], motion=slots["motion"][k : k + 1])
            assert torch.allclose(y[k, c], each[0, 0])


class OnPoints(Warp):
    """A warp that says that its motion is points, as the checks of operators want."""

    def slots(self, x_shape, n_frames):
        return {"motion": (n_frames, *self.size, 2)}


def test_points_are_exact_with_exact_adjoint_and_gradients():
    def reference(x, slots):
        away = ((11 - 1) / 2, (12 - 1) / 2)  # the canvas' centre
        shift = (2 + 5 / 2 - away[0], 3 + 6 / 2 - away[1])  # of the frame's centre from it
        at = [slots["motion"][..., 1] + shift[0] + away[0], slots["motion"][..., 0] + shift[1] + away[1]]
        inside = [np.clip(each, 1, side - 2) for each, side in zip(at, (11, 12), strict=True)]
        found = [ndimage.map_coordinates(x[0, 0], each, order=3, prefilter=False) for each in zip(*inside, strict=True)]
        return np.stack(found)[:, None]

    x = torch.rand(1, 1, 11, 12, dtype=torch.float64)
    check_operator(OnPoints((6, 7), (11, 12), (2, 3)), x, {"motion": points((6, 7))}, reference=reference)


def test_points_of_a_homography_are_the_same_motion():
    operator, x, slots = Warp.example()
    motion, mask = project_pixels(slots["motion"], operator.size), torch.ones_like(x)
    assert torch.allclose(operator(x, motion=motion), operator(x, **slots))
    assert torch.equal(operator.valid(mask, motion=motion), operator.valid(mask, **slots))


def test_a_sample_is_valid_where_its_coefficients_lie_in_the_canvas():
    operator, motion = Warp((6, 7), (11, 12), (2, 3)), points((6, 7), shift=6.0)
    at = operator.sampling_points(motion)
    inside = (at[..., 0].abs() <= 4.5) & (at[..., 1].abs() <= 4)
    assert torch.equal(operator.valid(torch.ones(1, 1, 11, 12), motion=motion)[:, 0] > 0, inside)


def test_kornia_warps_the_same_way():
    # Second opinion: kornia takes the inverse, in array indices; align_corners=False is right from 0.9 on.
    from kornia.geometry.transform import warp_perspective

    motion = torch.eye(3, dtype=torch.float64).repeat(4, 1, 1)
    motion[:, :2] += 0.02 * torch.randn(4, 2, 3, dtype=torch.float64)
    motion[:, :2, 2] *= 100
    motion[:, 2, :2] = 1e-4 * torch.randn(4, 2, dtype=torch.float64)
    operator = Warp((30, 41), (50, 60), (9, 8))
    # A slope, on which all interpolations agree.
    y, x = torch.meshgrid(torch.arange(50.0).double(), torch.arange(60.0).double(), indexing="ij")
    x = (2 * x - 3 * y)[None, None]
    to_centre, to_canvas = torch.eye(3, dtype=torch.float64), torch.eye(3, dtype=torch.float64)
    to_centre[:2, 2] = torch.tensor([-20, -14.5])
    to_canvas[:2, 2] = torch.tensor([20 + 8, 14.5 + 9])
    pushed = torch.linalg.inv(to_canvas @ motion @ to_centre)
    inside = operator.valid(torch.ones_like(x), motion=motion) > 0
    assert inside.double().mean() > 0.9
    for align_corners in (False, True):
        theirs = warp_perspective(x.expand(4, 1, 50, 60), pushed, (30, 41), align_corners=align_corners)
        assert torch.allclose(operator(x, motion=motion)[inside], theirs[inside], atol=1e-9)
