"""Every registered operator is what it says it is, and what an independent reference says it should be."""

import itertools

import numpy as np
import pytest
import torch
from scipy import signal
from scipy.interpolate import BSpline
from skimage.measure import block_reduce

from deepir.operators import Blur, Downsample, Lag, Operator, Warp
from deepir.registry import components
from deepir.testing import check_operator

OPERATORS, NUMBERS = components("operator"), itertools.count()


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


def sensor(x, slots):
    y = np.empty_like(x)
    for index in np.ndindex(x.shape):
        k, _, i, j = index
        gain, offset = slots["gain"][0, 0, i, j], slots["offset"][0, 0, i, j]
        y[index] = gain * x[index] + offset + slots["level"][k, 0, 0, 0]
    return y


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


#: Independent implementations, by the names of the operators; sizes and times are those of the examples.
REFERENCES = {
    "add": lambda x, slots: np.stack([frame + slots["value"][0] for frame in x]),
    "blur": blur,
    "decay": lambda x, slots: np.stack([x[0] / np.exp(time * slots["rate"][0]) for time in (0.0, 1.0, 2.5)]),
    "downsample": lambda x, slots: block_reduce(x, (1, 1, 3, 3), np.mean),
    "exposure": lambda x, slots: np.stack([time.item() * x[0] for time in slots["time"]]),
    "lag": lag,
    "mask": lambda x, slots: np.where(slots["keep"], slots["keep"] * x, 0),
    "matrix": lambda x, slots: np.stack([(slots["matrix"][0, 0] @ each.ravel())[None, :, None] for each in x]),
    "mix": lambda x, slots: np.stack([slots["a"][k] * x[0] + slots["b"][k] * slots["s"][0] for k in range(3)]),
    "path_blur": path_blur,
    "rolling_shutter": rolling_shutter,
    "sensor": sensor,
    "warp": warp,
}


@pytest.mark.parametrize("name", OPERATORS)
def test_the_example_of_every_registered_operator_passes(name):
    operator, x, slots = OPERATORS[name].example()
    check_operator(operator, x, slots, reference=REFERENCES.get(name))
    assert REFERENCES.keys() <= OPERATORS.keys()


def test_a_downsampling_that_is_not_whole_integrates_parts_of_pixels():
    def reference(x, slots):
        halves = x.repeat(2, -1).repeat(2, -2)
        return block_reduce(halves, (1, 1, 3, 3), np.mean)

    _, x, _ = Downsample.example()
    check_operator(Downsample(factor=1.5), x, {}, reference=reference)


def test_a_blur_may_be_of_each_frame():
    def reference(x, slots):
        return np.stack([blur(x[:1], {"psf": psf[None]})[0] for psf in slots["psf"]])

    _, x, slots = Blur.example()
    psf = torch.cat((slots["psf"], slots["psf"].mT, slots["psf"].flip(-1)))
    check_operator(Blur(radius=1, per_frame=True), x[:1], {"psf": psf}, reference=reference)


def double(x):
    return 2 * x


def made(forward, **members):
    """An operator of this forward map."""
    members["forward"] = lambda self, x, **slots: forward(x)
    return type("Made", (Operator,), members)()


def overwrite(x):
    return x.mul_(1 + 1e-3) / x * x.clone() if x.requires_grad else x.add_(1) - 1


@pytest.mark.parametrize(
    ("operator", "message"),
    [
        (made(lambda x: x[..., 1:]), "out_shape"),
        (made(lambda x: x.double()), "float32 became"),
        (made(lambda x: x * next(NUMBERS)), "state"),
        (made(overwrite), "state|in place"),
        (made(lambda x: x + 1), "linear = False"),
        (made(torch.square, linear=False), "not linear in x"),
        (made(double, adjoint=lambda self, y, x_shape: y), "<A x, y>"),
        (made(lambda x: x + x.roll(1, -1)), "depends on an invalid"),
        (made(lambda x: x + x.detach(), adjoint=lambda self, y, x_shape: 2 * y), "wrong gradient"),
    ],
)
def test_a_broken_operator_is_found_out(operator, message):
    x = torch.rand(2, 1, 5, 6, dtype=torch.float64)
    with pytest.raises(AssertionError, match=message):
        check_operator(operator, x, {})


def test_a_forward_map_or_an_adjoint_unlike_the_reference_is_found_out():
    x = torch.rand(1, 1, 3, 4, dtype=torch.float64)
    with pytest.raises(AssertionError, match="forward map"):
        check_operator(made(double), x, {}, reference=lambda x, slots: 3 * x)


def test_a_nonlinear_operator_may_say_so():
    honest = made(torch.square, linear=False, affine=False)
    check_operator(honest, torch.rand(2, 1, 5, 6, dtype=torch.float64), {}, reference=lambda x, slots: x**2)


@pytest.mark.parametrize("factor", [1, 2, 5, (2, 1), (4, 5)])
def test_downsample_takes_any_integer_factor_of_either_axis(factor):
    x = torch.rand(1, 1, 20, 30, dtype=torch.float64)
    wanted = block_reduce(x.numpy(), (1, 1, *np.broadcast_to(factor, 2)), np.mean)
    assert np.allclose(Downsample(factor=factor)(x), wanted)


def test_blur_takes_several_channels():
    x, psf = torch.rand(2, 3, 6, 7, dtype=torch.float64), torch.rand(1, 1, 3, 3, dtype=torch.float64)
    assert np.allclose(Blur(radius=1)(x, psf=psf), blur(x.numpy(), {"psf": psf.numpy()}))


def test_a_large_kernel_still_sees_one_invalid_pixel():
    mask = torch.ones(1, 1, 151, 151)
    mask[0, 0, 75, 75] = 0
    assert Blur(radius=60).valid(mask, psf=torch.ones(1, 1, 121, 121)).sum() == 0


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: Downsample(factor=2)(torch.rand(1, 1, 21, 30)), "21 x 30 is no multiple"),
        (lambda: Downsample(factor=0), "1 to 8, not 0"),
        (lambda: Downsample(factor=(2, 1, 1)), "one number, or two"),
        (lambda: Downsample(factor=(1.5, 2)).in_size((7, 8)), "7 x 8 px times 1.5 x 2 are no whole pixels"),
        (lambda: Downsample(factor=1.5).in_size((7, 8)), "crop the frames to sides that are multiples of 2"),
        (lambda: Blur(radius=-1), "radius must be 0 to 100 px"),
        (lambda: Lag(None), "the rate of the frames is needed, for example data.fps=60"),
        (lambda: Lag(60.0, substeps=0), "substeps must be 1 to 100, not 0"),
        (lambda: Lag(60.0, readout=1.5), "readout must be 0 to 1, not 1.5"),
        (lambda: Lag(60.0)(torch.rand(6, 1, 1, 1)), "lag: 6 instants are not 4 for each frame and one to begin with"),
        (lambda: Warp((3, 4), (5, 3), (1, 0)), "less than 4"),
        (lambda: Warp((3, 4), (5, 5), (1, 0))(torch.rand(1, 1, 5, 6), motion=torch.eye(3)[None]), "the canvas is"),
        (lambda: Warp((3, 4), (5, 5), (1, 0))(torch.rand(2, 1, 5, 5), motion=torch.eye(3).repeat(3, 1, 1)), "2 scenes"),
    ],
)
def test_what_makes_no_sense_is_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        wrong()
