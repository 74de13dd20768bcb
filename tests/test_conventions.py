"""The conventions of docs/reference/conventions.md that no test of a component pins."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from deepir.assembly import build
from deepir.burst import Burst
from deepir.config import load
from deepir.operators import Add, Blur, Chain, Downsample, Sensor, Warp
from deepir.operators.warp import CANVAS_MARGIN, footprint
from deepir.registry import components
from deepir.result import Result, to_gauge

few = settings(max_examples=25, deadline=None)


def homography(*, angle=0.0, x=0.0, y=0.0):
    cos, sin = math.cos(angle), math.sin(angle)
    return torch.tensor([[cos, -sin, x], [sin, cos, y], [0, 0, 1]], dtype=torch.float64)


def warped(scene, motion, size, origin):
    """A frame of the scene that looks like `scene` at rest."""
    operator = Warp(size, tuple(scene.shape), origin)
    coefficients = torch.from_numpy(ndimage.spline_filter(scene.double().numpy(), 3, mode="mirror")).to(scene)
    return operator(coefficients[None, None], motion=motion[None])[0, 0]


def picture(height=21, width=24):
    return torch.rand(height, width, dtype=torch.float64, generator=torch.Generator().manual_seed(3))


# The model


def test_the_model_is_gain_times_blurred_integrated_warped_scene_plus_stray_then_offset_and_level():
    warp, blur, downsample = Warp((14, 16), (20, 22), (3, 3)), Blur(radius=1), Downsample(factor=2)
    chain = Chain({"warp": warp, "blur": blur, "downsample": downsample, "stray": Add(), "sensor": Sensor()})
    shapes = chain.slots((1, 1, 20, 22), 2)
    assert " ".join(shapes) == "warp.motion blur.psf stray.value sensor.gain sensor.offset sensor.level"
    assert shapes["stray.value"] == shapes["sensor.gain"] == shapes["sensor.offset"] == (1, 1, 6, 7)
    assert shapes["sensor.level"] == (2, 1, 1, 1)
    slots = {name: torch.rand(shape) for name, shape in shapes.items()}
    slots["warp.motion"] = torch.eye(3).repeat(2, 1, 1)
    x = torch.rand(1, 1, 20, 22)
    z = downsample(blur(warp(x, motion=slots["warp.motion"]), psf=slots["blur.psf"]))
    y = slots["sensor.gain"] * (z + slots["stray.value"]) + slots["sensor.offset"] + slots["sensor.level"]
    assert torch.allclose(chain(x, **slots), y)


# Geometry


def test_pixel_centres_lie_at_integers_so_a_whole_pixel_shift_is_exact():
    scene = picture()
    for x, y in [(0, 0), (1, 0), (0, 2), (-3, 1)]:
        frame = warped(scene, homography(x=x, y=y), (11, 12), (5, 6))
        assert torch.allclose(frame, scene[5 + y : 16 + y, 6 + x : 18 + x], atol=1e-12, rtol=0)
        in_float32 = warped(scene.float(), homography(x=x, y=y).float(), (11, 12), (5, 6))
        assert torch.allclose(in_float32, scene[5 + y : 16 + y, 6 + x : 18 + x].float(), atol=1e-5, rtol=0)


def test_warps_pull_so_plus_x_looks_right_and_plus_y_looks_down():
    # frame(p) = scene(p + t): with t to the right, what the frame shows has moved to the left.
    scene = torch.zeros(21, 24, dtype=torch.float64)
    scene[10, 12] = 1
    assert warped(scene, homography(x=2), (11, 12), (5, 6))[10 - 5, 12 - 6 - 2] == pytest.approx(1)
    assert warped(scene, homography(y=2), (11, 12), (5, 6))[10 - 5 - 2, 12 - 6] == pytest.approx(1)


def test_a_positive_angle_turns_plus_x_towards_plus_y():
    # A quarter turn: a frame pixel right of the centre looks at the scene below the centre.
    scene = torch.zeros(11, 11, dtype=torch.float64)
    scene[5 + 3, 5] = 1
    frame = warped(scene, homography(angle=math.pi / 2), (11, 11), (0, 0))
    assert frame[5, 5 + 3] == pytest.approx(1)


@pytest.mark.parametrize("size", [(11, 12), (10, 13)])
def test_the_origin_of_a_motion_is_the_frames_centre(size):
    # Half a turn about the centre is a flip of both axes, for odd and even sides.
    scene = picture()
    frame = warped(scene, homography(angle=math.pi), size, (5, 6))
    straight = warped(scene, homography(), size, (5, 6))
    assert torch.allclose(frame, straight.flip(0, 1))


@pytest.mark.parametrize("name", ["shift", "rigid", "affine", "homography", "auto"])
def test_frame_0_is_the_reference_always(name):
    field = components("field")[name]((3, 3, 3), size=(60, 80))
    with torch.no_grad():
        field.values.normal_()
    assert torch.equal(field()[0], torch.eye(3))
    assert (field()[:, 2, 2] == 1).all()
    # A burst whose frame 0 has another motion is the same burst, seen from frame 0.
    given = torch.stack([homography(x=2, y=-1), homography(x=3, y=1), homography(x=2, y=0)])
    field.init_from(given)
    relative = torch.stack([homography(), homography(x=1, y=2), homography(x=0, y=1)])
    assert torch.allclose(field().double(), relative, atol=1e-5)


@few
@given(
    x=st.floats(-12, 12), y=st.floats(-12, 12), angle=st.floats(-0.1, 0.1),
    size=st.tuples(st.integers(8, 40), st.integers(8, 40)),
)  # fmt: skip
def test_the_canvas_is_the_union_of_the_footprints_plus_8_px_with_frame_0_at_an_integer(x, y, angle, size):
    motion = torch.stack([homography(), homography(x=x, y=y, angle=angle)])
    (height, width), (y0, x0) = footprint(motion, size, 1.0)
    assert isinstance(y0, int)
    assert isinstance(x0, int)
    centre = torch.tensor([(size[1] - 1) / 2, (size[0] - 1) / 2], dtype=torch.float64)
    corners = torch.tensor([[sx * centre[0], sy * centre[1], 1] for sx in (-1, 1) for sy in (-1, 1)])
    seen = (motion @ corners.double().T)[:, :2].transpose(1, 2).reshape(-1, 2) + centre
    first = torch.tensor([x0, y0])
    room = torch.cat([seen.amin(0) + first, torch.tensor([width, height]) - 1 - seen.amax(0) - first])
    assert CANVAS_MARGIN == 8
    assert room.min() >= CANVAS_MARGIN - 1e-9
    assert (room[:2] < CANVAS_MARGIN + 1).all()
    for more, side in zip(room[2:] - CANVAS_MARGIN, (width, height), strict=True):  # up to a size of a quick transform
        assert more < 2 + 0.1 * side


def test_the_canvas_holds_the_blurs_radius_too():
    # The warp's output is larger than the frame by the radius: footprints are those of what the blur reads.
    size = Chain({"blur": Blur(radius=3)}).in_size((20, 30))
    assert footprint(None, size, 1.0) == ((20 + 6 + 16, 30 + 6 + 16 + 2), (8, 8))


def test_validity_that_the_corners_tell_is_that_of_all_samples():
    operator = Warp((20, 30), (40, 46), (10, 8))
    for x, angle in ((0.0, 0.0), (3.0, 0.1), (9.0, 0.0), (0.0, 0.5)):
        motion = homography(x=x, angle=angle)[None]
        reach = torch.tensor([(46 - 3) / 2, (40 - 3) / 2]) + 1e-4
        each = (operator.sampling_points(motion).abs() <= reach).all(-1)[:, None]
        assert torch.equal(operator.valid(torch.ones(1, 1, 40, 46), motion=motion) > 0, each)


# Gauge and units


@few
@given(seed=st.integers(0, 1000), pedestal=st.sampled_from([0.0, 100.0, 8000.0]))
def test_the_gauge_is_kept_and_does_not_change_the_prediction(seed, pedestal):
    rng = np.random.default_rng(seed)
    bad = rng.random((9, 11)) < 0.1
    used = np.array([True, False, True])
    result = Result(
        scene=pedestal + 10 * rng.random((9, 11)),
        gain=0.8 + 0.5 * rng.random((9, 11)),
        offset=5 * rng.standard_normal((9, 11)) + 3,
        motion=np.tile(np.eye(3), (3, 1, 1)),
        level=rng.standard_normal(3),
        bad_pixels=bad,
        frames_used=used,
        extra={"stray": 2 + 4 * rng.random((9, 11))},
    )

    def prediction():
        maps = (result.scene, result.gain, result.offset, result.extra["stray"])
        scene, gain, offset, stray = (each.astype(float) for each in maps)
        return gain * (scene + stray) + offset + result.level[used][:, None, None].astype(float)

    before = prediction()
    to_gauge(result, flux=["stray"])
    assert np.allclose(prediction(), before, rtol=1e-6, atol=1e-4)
    assert result.gain[~bad].mean(dtype=float) == pytest.approx(1, abs=1e-6)
    assert result.offset[~bad].mean(dtype=float) == pytest.approx(0, abs=1e-5 * (1 + pedestal))
    assert result.level[used].mean(dtype=float) == pytest.approx(0, abs=1e-6)
    assert result.extra["stray"][~bad].mean(dtype=float) == pytest.approx(0, abs=1e-6)


# Bad pixels


def test_no_sample_of_a_bad_pixel_and_none_that_is_not_finite_is_used():
    rng = np.random.default_rng(0)
    frames = 100 + rng.random((2, 12, 14)).astype(np.float32)
    frames[1, 3, 4] = np.nan
    valid = np.isfinite(frames)
    bad = np.zeros((12, 14), bool)
    bad[5, 6] = True
    config = load({"physics": {"sensor": {}}, "scene": {"type": "pixels"}})
    problem, _ = build(config, Burst(np.where(valid, frames, 0), valid, bad))
    unused = (problem.precision == 0).nonzero()[:, [0, 2, 3]].tolist()
    assert unused == [[0, 5, 6], [1, 3, 4], [1, 5, 6]]
