"""Every registered operator is what it says it is, and what an independent reference says it should be."""

import numpy as np
import pytest
import torch
from scipy import signal
from scipy.interpolate import BSpline
from skimage.measure import block_reduce

from deepir.operators import Blur, Downsample, Operator, Sensor, Warp
from deepir.registry import components
from deepir.testing import check_operator


def warp(x, slots):
    size, origin = (6, 7), (2, 3)  # of the example
    rows, columns = np.mgrid[: size[0], : size[1]]
    points = np.stack((columns - 3.0, rows - 2.5, np.ones(size)), -1)
    spline = BSpline.basis_element([-2, -1, 0, 1, 2], extrapolate=False)
    frames = []
    for matrix in slots["motion"]:
        px, py, pz = (points @ matrix.T).transpose(2, 0, 1)
        at = (py / pz + 2.5 + origin[0], px / pz + 3.0 + origin[1])
        inside = (np.clip(i, 1, side - 2) for i, side in zip(at, x.shape[2:], strict=True))
        sides = (np.arange(side) for side in x.shape[2:])
        wy, wx = (np.nan_to_num(spline(i[..., None] - j)) for i, j in zip(inside, sides, strict=True))
        frames.append([np.einsum("hwi,hwj,ij->hw", wy, wx, x[0, 0])])
    return np.array(frames)


def blur(x, slots):
    return np.stack([[signal.convolve2d(c, slots["psf"][0, 0], mode="valid") for c in frame] for frame in x])


def downsample(x, slots):
    return block_reduce(x, (1, 1, 3, 3), np.mean)


def sensor(x, slots):
    y = np.empty_like(x)
    for index in np.ndindex(x.shape):
        k, _, i, j = index
        gain, offset = slots["gain"][0, 0, i, j], slots["offset"][0, 0, i, j]
        y[index] = gain * x[index] + offset + slots["level"][k, 0, 0, 0]
    return y


def add(x, slots):
    return np.stack([frame + slots["value"][0] for frame in x])


def lag(x, slots):
    """A recursive filter for each pixel, its weights from integrals of the parabola through three instants."""
    dt = 1000 / 60 / 2  # of the example
    at, weight = (each / 2 for each in np.polynomial.legendre.leggauss(30))
    at = at + 0.5  # of the step's time
    lagrange = ((at * (at - 1) / 2), (1 - at**2), (at * (at + 1) / 2))
    out = np.empty((3, *x.shape[1:]))
    share = slots["moving"].item()
    x = np.concatenate([share * x[:2] + (1 - share) * x[2], x[2:]])  # two instants before the first frame
    for i, j in np.ndindex(x.shape[2:]):
        tau = slots["tau"][0, 0, i, j]
        kernel = weight * dt / tau * np.exp(-(1 - at) * dt / tau)
        earlier, before, now = ((kernel * each).sum() for each in lagrange)
        # From rest: what is above the first flux starts at zero.
        rise = signal.lfilter([now, before, earlier], [1, -np.exp(-dt / tau)], x[:, 0, i, j] - x[0, 0, i, j])
        out[:, 0, i, j] = x[0, 0, i, j] + rise[2::2]
    return out


def mask(x, slots):
    return np.where(slots["keep"], slots["keep"] * x, 0)


def mix(x, slots):
    return np.stack([a.item() * x[0] + b.item() * slots["s"][0] for a, b in zip(slots["a"], slots["b"], strict=True)])


def exposure(x, slots):
    return np.stack([time.item() * x[0] for time in slots["time"]])


def decay(x, slots):
    return np.stack([x[0] / np.exp(time * slots["rate"][0]) for time in (0.0, 1.0, 2.5)])  # of the example


def matrix(x, slots):
    return np.stack([(slots["matrix"][0, 0] @ scene.ravel())[None, :, None] for scene in x])


def path_blur(x, slots):
    """The mean of shifted scenes, each by sums over Lanczos' kernel."""
    margin, (height, width) = 4, x.shape[2:]
    frames = np.zeros((len(slots["path"]), 1, height - 2 * margin, width - 2 * margin))
    for k, i, j in np.ndindex(frames.shape[0], *frames.shape[2:]):
        weights = np.zeros((height, width))
        for dx, dy in slots["path"][k, 0]:
            down, across = np.arange(height) - i - margin - dy, np.arange(width) - j - margin - dx
            weights += np.outer(*(np.where(abs(d) < 3, np.sinc(d) * np.sinc(d / 3), 0) for d in (down, across)))
        frames[k, 0, i, j] = (weights * x[0, 0]).sum() / weights.sum()
    return frames


def rolling_shutter(x, slots):
    """The warp's rows, each of the motion of its own time."""
    motion, readout = slots["motion"], slots["readout"].item()
    times = np.arange(3)[:, None] + readout * (np.arange(6) - 2.5) / 5
    before = np.clip(np.floor(times), 0, 1).astype(int)
    part = (times - before)[..., None, None]
    each = (1 - part) * motion[before] + part * motion[before + 1]
    rows = [warp(x, {"motion": each[:, row]})[:, :, row] for row in range(6)]
    return np.stack(rows, 2)


REFERENCES = {
    each.__name__: each
    for each in (add, blur, decay, downsample, exposure, lag, mask, matrix, mix, path_blur, rolling_shutter)
} | {"warp": warp, "sensor": sensor}


@pytest.mark.parametrize("name", components("operator"))
def test_the_example_of_every_registered_operator_passes(name):
    operator, x, slots = components("operator")[name].example()
    check_operator(operator, x, slots, reference=REFERENCES.get(name))


def test_a_downsampling_that_is_not_whole_integrates_parts_of_pixels():
    def reference(x, slots):
        halves = x.repeat(2, -1).repeat(2, -2)
        return block_reduce(halves, (1, 1, 3, 3), np.mean)

    _, x, _ = Downsample.example()
    check_operator(Downsample(factor=1.5), x, {}, reference=reference)
    with pytest.raises(ValueError, match="crop the frames to sides that are multiples of 2"):
        Downsample(factor=1.5).in_size((7, 8))


def test_a_blur_may_be_of_each_frame():
    def reference(x, slots):
        return np.stack([blur(x[:1], {"psf": psf[None]})[0] for psf in slots["psf"]])

    _, x, slots = Blur.example()
    psf = torch.cat((slots["psf"], slots["psf"].mT, slots["psf"].flip(-1)))
    check_operator(Blur(radius=1, per_frame=True), x[:1], {"psf": psf}, reference=reference)


def test_the_references_belong_to_operators():
    assert REFERENCES.keys() <= components("operator").keys()


class Broken(Operator):
    def forward(self, x, **slots):
        return 2 * x


class Shrinks(Broken):
    def forward(self, x, **slots):
        return x[..., 1:]


class Casts(Broken):
    def forward(self, x, **slots):
        return x.double()


class Remembers(Broken):
    calls = 0

    def forward(self, x, **slots):
        self.calls += 1
        return x * self.calls


class Overwrites(Broken):
    def forward(self, x, **slots):
        return x.mul_(1 + 1e-3) / x * x.clone() if x.requires_grad else x.add_(1) - 1


class Shifts(Broken):
    def forward(self, x, **slots):
        return x + 1


class Squares(Broken):
    linear = False

    def forward(self, x, **slots):
        return x.square()


class WrongAdjoint(Broken):
    def adjoint(self, y, x_shape, **slots):
        return y


class Smears(Broken):
    def forward(self, x, **slots):
        return x + x.roll(1, -1)


class WrongGradient(Broken):
    def forward(self, x, **slots):
        return x + x.detach()

    def adjoint(self, y, x_shape, **slots):
        return 2 * y


@pytest.mark.parametrize(
    ("broken", "message"),
    [
        (Shrinks, "out_shape"),
        (Casts, "float32 became"),
        (Remembers, "state"),
        (Overwrites, "state|in place"),
        (Shifts, "linear = False"),
        (Squares, "not linear in x"),
        (WrongAdjoint, "<A x, y>"),
        (Smears, "depends on an invalid"),
        (WrongGradient, "wrong gradient"),
    ],
)
def test_a_broken_operator_is_found_out(broken, message):
    x = torch.rand(2, 1, 5, 6, dtype=torch.float64)
    with pytest.raises(AssertionError, match=message):
        check_operator(broken(), x, {})


def test_a_forward_map_or_an_adjoint_unlike_the_reference_is_found_out():
    x = torch.rand(1, 1, 3, 4, dtype=torch.float64)
    with pytest.raises(AssertionError, match="forward map"):
        check_operator(Broken(), x, {}, reference=lambda x, slots: 3 * x)


def test_a_nonlinear_operator_may_say_so():
    class Honest(Squares):
        affine = False

    check_operator(Honest(), torch.rand(2, 1, 5, 6, dtype=torch.float64), {}, reference=lambda x, slots: x**2)


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


def test_a_motion_given_as_points_is_the_same_as_the_homography():
    from deepir.operators.warp import project_pixels

    operator, x, slots = Warp.example()
    points = project_pixels(slots["motion"], operator.size)
    assert torch.allclose(operator(x, motion=points), operator(x, **slots))
    mask = torch.ones_like(x)
    assert torch.equal(operator.valid(mask, motion=points), operator.valid(mask, **slots))


def test_a_motion_that_is_not_a_number_gives_numbers_and_gradients():
    # torch's own grid_sample takes the process down with it.
    operator, x, slots = Warp.example()
    for bad in (float("nan"), float("inf"), -1e30):
        for index in ((1, 0, 2), (1, 0, 0), (1, 2, 1)):
            motion = slots["motion"].clone()
            motion[index] = bad
            motion.requires_grad_()
            x = x.detach().requires_grad_()
            y = operator(x, motion=motion)
            assert y.isfinite().all()
            assert all(g.isfinite().all() for g in torch.autograd.grad(y.sum(), (x, motion)))


def test_a_scene_that_is_not_the_canvas_is_refused():
    operator, x, slots = Warp.example()
    with pytest.raises(ValueError, match="the canvas is"):
        operator(x[..., 1:], **slots)


def test_kornia_warps_the_same_way():
    # Second opinion: kornia takes the inverse, in array indices; align_corners=False is right from 0.9 on.
    from kornia.geometry.transform import warp_perspective

    torch.manual_seed(0)
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


@pytest.mark.parametrize("factor", [1, 2, 5])
def test_downsample_takes_any_integer_factor(factor):
    x = torch.rand(1, 1, 20, 30, dtype=torch.float64)
    wanted = block_reduce(x.numpy(), (1, 1, factor, factor), np.mean)
    assert np.allclose(Downsample(factor=factor)(x), wanted)


def test_downsample_refuses_sides_that_do_not_divide():
    with pytest.raises(ValueError, match="21 x 30 is no multiple"):
        Downsample(factor=2)(torch.rand(1, 1, 21, 30))
    with pytest.raises(ValueError, match="1 to 8, not 0"):
        Downsample(factor=0)


def test_blur_has_a_radius_and_takes_several_channels():
    with pytest.raises(ValueError, match="radius must be 0 to 100 px"):
        Blur(radius=-1)
    x, psf = torch.rand(2, 3, 6, 7, dtype=torch.float64), torch.rand(1, 1, 3, 3, dtype=torch.float64)
    assert np.allclose(Blur(radius=1)(x, psf=psf), blur(x.numpy(), {"psf": psf.numpy()}))


def test_a_large_kernel_still_sees_one_invalid_pixel():
    mask = torch.ones(1, 1, 151, 151)
    mask[0, 0, 75, 75] = 0
    assert Blur(radius=60).valid(mask, psf=torch.ones(1, 1, 121, 121)).sum() == 0


def test_the_sensor_of_neutral_slots_changes_nothing():
    x = torch.rand(3, 1, 4, 5)
    shapes = Sensor().slots(x.shape, 3)
    assert torch.equal(Sensor()(x, **{n: torch.full(s, Sensor.neutral[n]) for n, s in shapes.items()}), x)
