"""Registration finds the camera's motion and is not fooled by what stands still; its compiled loops."""

import functools
import itertools

import numpy as np
import pytest
import scipy.ndimage
import skimage.data
import torch
from hypothesis import given
from hypothesis import settings as settings_of_hypothesis
from hypothesis import strategies as st
from registered import COUNTS, simulated
from torch.testing import assert_close

from deepir.errors import DataError
from deepir.kernels import threads
from deepir.operators.motion_models import rotation
from deepir.registration import register
from deepir.registration.preprocess import Level, sample, variance_stabilise

SHAPE = (96, 120)
ZOOM = 2.0  # picture pixels per detector pixel


def move(angle=0.0, x=0.0, y=0.0, stretch=((1.0, 0.0), (0.0, 1.0))):
    """A pull motion: rotation by `angle` degrees and shift, times a 2 x 2 stretch."""
    c, s = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
    motion = np.eye(3)
    motion[:2, :2] = np.array([[c, -s], [s, c]]) @ np.array(stretch)
    motion[:2, 2] = x, y
    return motion


def apply(motion, points):
    moved = motion[:2, :2] @ points + motion[:2, 2:]
    return moved / (motion[2:, :2] @ points + 1)


@functools.cache
def spline(name):
    return scipy.ndimage.spline_filter(getattr(skimage.data, name)() / 255.0, 3, mode="mirror")


def view(name, motion, shape=SHAPE):
    """What area-integrating pixels see of a public picture (3 x 3 points a pixel, cubic spline)."""
    picture = spline(name)
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    points = np.stack([columns.ravel() - (shape[1] - 1) / 2, rows.ravel() - (shape[0] - 1) / 2])
    total, centre = 0, (np.array(picture.shape) - 1) / 2
    for shift in itertools.product((-1 / 3, 0, 1 / 3), repeat=2):
        x, y = apply(motion, points + np.array(shift)[:, None]) * ZOOM
        total = total + scipy.ndimage.map_coordinates(picture, [y + centre[0], x + centre[1]], prefilter=False)
    return np.clip(total.reshape(shape) / 9, 0.01, None)


def burst(name, motions, gain=1.0, tau=1000.0, seed=0):
    rng = np.random.default_rng(seed)
    flux = gain * np.stack([view(name, motion) for motion in motions])
    return torch.tensor(flux + rng.normal(size=flux.shape) * np.sqrt(flux.clip(1e-3) / tau), dtype=torch.float32)


def errors(result, motions, shape=SHAPE):
    """Mean distance (px) over the frame between found and true motion, of each frame but the first."""
    x, y = np.meshgrid([-0.4 * shape[1], 0, 0.4 * shape[1]], [-0.4 * shape[0], 0, 0.4 * shape[0]])
    points = np.stack([x.ravel(), y.ravel()])
    pairs = zip(result.motion.numpy()[1:], motions[1:], strict=True)
    return np.array([np.hypot(*(apply(found, points) - apply(true, points))).mean() for found, true in pairs])


TURNED = [move(), move(6, 10, -7), move(-5, -8, 9), move(3, 4, 10), move(-2, -10, -3)]
SHIFTED = [move(), move(x=4, y=-3), move(x=-6.4, y=2.7), move(x=1.5, y=7.2)]


def gain(kind):
    """Gains of half the range in columns, of a tenth in pixels, or none."""
    columns, pixels = np.random.default_rng(1), np.random.default_rng(2)
    gains = {"columns": columns.uniform(0.5, 1, (1, SHAPE[1])), "pixels": 1 + 0.1 * pixels.normal(size=SHAPE)}
    return gains.get(kind, 1.0)


@pytest.mark.parametrize("name", ["camera", "moon", "grass"])
def test_shifts_are_not_pulled_to_whole_pixels(name):
    motions = [move(), move(x=5.25, y=-3.25), move(x=-4.75, y=6.3), move(x=2.2, y=-7.2), move(x=4, y=-3)]
    result = register(burst(name, motions, tau=1e5), model="shift")
    assert errors(result, motions).max() < 0.05
    assert result.motion.dtype == torch.float64


@pytest.mark.parametrize(
    ("name", "motions", "pattern", "photons"),
    [
        ("camera", SHIFTED, "columns", 1000),
        ("coins", TURNED, "columns", 1000),
        ("camera", TURNED, "pixels", 200),
        ("coins", TURNED, "none", 1000),
    ],
)
def test_a_pattern_does_not_bias_the_motion(name, motions, pattern, photons):
    result = register(burst(name, motions, gain(pattern), photons))
    assert result.used.all()
    assert np.median(errors(result, motions)) < 0.1
    assert torch.equal(result.motion[0], torch.eye(3, dtype=torch.float64))


def test_counts_on_a_pedestal_with_offsets_and_dead_pixels():
    rng = np.random.default_rng(3)
    h, w = SHAPE
    frames = 8000 + 1500 * np.stack([view("camera", motion) for motion in TURNED])
    frames *= 1 + rng.normal(0, 0.03, SHAPE) + rng.normal(0, 0.01, (1, w))
    frames += rng.normal(0, 60, (1, w)) + rng.normal(0, 40, (h, 1)) + rng.normal(0, 5, frames.shape)
    frames[:, rng.random(SHAPE) < 0.004] = 0
    frames[:, rng.random(SHAPE) < 0.002] = 16383
    result = register(torch.tensor(frames))
    assert np.median(errors(result, TURNED)) < 0.15


@pytest.mark.parametrize("model", ["affine", "homography"])
def test_stretch_and_perspective_are_found(model):
    motions = [move(), move(2, 5, -4, ((1.02, 0.01), (0, 0.98))), move(-2, -6, 3, ((0.99, 0), (0.015, 1.01)))]
    if model == "homography":
        motions[1][2, :2] = 2e-4, -1e-4
    gain = np.random.default_rng(1).uniform(0.8, 1, (1, SHAPE[1]))
    assert errors(register(burst("camera", motions, gain), model=model), motions).max() < 0.2


def test_ignored_pixels_do_not_matter():
    frames = burst("camera", TURNED[:3])
    ignore = torch.zeros(SHAPE, dtype=torch.bool)
    ignore[20:45, 30:70] = True
    frames[:, ignore] = 5.0
    garbage = frames.clone()
    garbage[:, ignore] = torch.nan
    result = register(frames, ignore=ignore)
    assert errors(result, TURNED[:3]).max() < 0.1
    assert torch.allclose(register(garbage, ignore=ignore).motion, result.motion, atol=1e-3)


@pytest.mark.parametrize("value", [0.0, 1.0, torch.nan])
def test_a_burst_without_texture_is_not_registered_one_frame_is_its_own_reference(value):
    result = register(torch.full((3, 33, 40), value))
    assert result.used.tolist() == [True, False, False]
    assert (result.confidence[1:] < 0.3).all()
    assert register(torch.rand(1, 40, 50)).used.all()


def test_wrong_arguments_are_named():
    with pytest.raises(DataError, match="did you mean 'affine'"):
        register(torch.zeros(2, 8, 8), model="afine")
    with pytest.raises(DataError, match="frames"):
        register(torch.zeros(2, 1, 8, 8))
    with pytest.raises(DataError, match="bad-pixel mask"):
        register(torch.zeros(2, 8, 8), ignore=torch.zeros(8, 9, dtype=torch.bool))


def test_frames_of_integers_register_as_the_same_frames_of_floats():
    counts = (8000 + 4000 * burst("camera", [move(), move(0.0, 3.0, -2.0), move(0.0, -4.0, 1.0)])).round()
    wanted = register(counts).motion
    for kind in (torch.uint16, torch.int32):
        assert torch.equal(register(counts.to(kind)).motion, wanted)


@given(st.floats(0.02, 0.1), st.floats(0.0, 0.1), st.integers(0, 99), st.sampled_from([1.0, 1500.0]))
@settings_of_hypothesis(max_examples=20, deadline=None)
def test_variance_stabilisation_makes_a_pattern_as_strong_in_the_bright_as_in_the_dark(gain, offset, seed, unit):
    rng = np.random.default_rng(seed)
    flux = np.tile(np.linspace(0.1, 1.5, 160), (128, 1))
    frame = flux * (1 + gain * rng.normal(size=flux.shape)) + offset * rng.normal(size=flux.shape)
    bent = variance_stabilise(torch.from_numpy(unit * frame)[None], torch.ones(128, 160))[0].numpy()
    fine = bent - scipy.ndimage.gaussian_filter(bent, 3)
    dark, bright = fine[:, :60].std(), fine[:, 100:].std()
    assert 0.6 < bright / dark < 1.6


@pytest.mark.parametrize("camera", [{"n_frames": 3, "max_rotation": 5.0}, {**COUNTS, "dead_pixels": 0.02}])
def test_the_number_of_threads_makes_no_difference_but_of_rounding(camera):
    frames, _ = simulated("camera", **camera)
    found = []
    for number in (1, 3):
        with threads.for_samples(threads.MIN_PARALLEL_SAMPLES, number):
            found.append(register(frames))
    assert_close(found[0].motion, found[1].motion, rtol=0, atol=1e-4)  # torch adds up by threads
    assert_close(found[0].confidence, found[1].confidence, rtol=0, atol=1e-5)


@pytest.mark.parametrize("bad", [0, 300])
@pytest.mark.parametrize("shape", [(2, 2), (9, 4), (30, 41)])
def test_samples_are_those_of_torch(shape, bad):
    """Also beyond the edge, under rotation and perspective; those on the very edge are left to rounding."""
    generator = torch.Generator().manual_seed(3)
    image, weight = torch.rand(shape, generator=generator), torch.ones(shape)
    weight.view(-1)[torch.randint(weight.numel(), (bad,), generator=generator)] = 0
    level = Level(1, image[None], weight, bad == 0, shape)
    motion = rotation(torch.tensor([0.0, 0.1, -0.4], dtype=torch.float64))
    motion[:, :2, 2] = torch.tensor([[0.3, -0.4], [3.2, 1.3], [-40.0, 0.2]])
    motion[1, 2, :2] = torch.tensor([1e-3, -2e-3])
    values, known = sample(image[None], motion, level)
    points = motion @ level.index_to_px @ indices(shape).flatten(1)
    points = (points[:, :2] / points[:, 2:]).reshape(3, 2, *shape).float()
    unit = points / torch.tensor(shape[::-1])[:, None, None] * 2
    ask = functools.partial(torch.nn.functional.grid_sample, grid=unit.movedim(1, -1), align_corners=False)
    wanted = ask(image.expand(3, 1, *shape), mode="bilinear")[:, 0]
    there = ask(weight.expand(3, 1, *shape), mode="nearest")[:, 0]
    edge = (torch.tensor(shape[::-1])[:, None, None] - 1) / 2
    there = there * (points.abs() <= edge).all(1)
    assert torch.equal(known, there)
    assert torch.allclose(values, wanted * there, atol=1e-5)


def indices(shape):
    y, x = torch.meshgrid(*(torch.arange(side, dtype=torch.float64) for side in shape), indexing="ij")
    return torch.stack((x, y, torch.ones_like(x)))
