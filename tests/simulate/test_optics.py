"""From the scene to the flux on the detector: motion, pixels, blurs, parallax, stray flux."""

import numpy as np
import pytest
from cameras import clean
from scipy import ndimage
from skimage.measure import block_reduce

from deepir.errors import ConfigError
from deepir.simulate import render, simulate
from deepir.simulate.optics import PSF_SAMPLES_PER_PIXEL, airy, psf

MODELS = ["shift", "rigid", "affine", "homography"]


def grid(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """(x, y) of the pixel centres, from the frame's centre."""
    y, x = (np.arange(n) - (n - 1) / 2 for n in shape)
    return x[None, :], y[:, None]


def shift(x: float, y: float) -> np.ndarray:
    return np.array([[1, 0, x], [0, 1, y], [0, 0, 1.0]])


# ---- motion and pixels ----


def test_a_whole_pixel_shift_gives_a_shifted_copy():
    picture = np.random.default_rng(0).random((90, 100))
    still, moved = render(picture, np.stack([shift(0, 0), shift(3, -2)]), (30, 40), scale=2.0)
    np.testing.assert_allclose(moved[2:, :-3], still[:-2, 3:], atol=1e-12)


@pytest.mark.parametrize("scale", [1.2, 2.0, 3.7])
def test_a_pixel_integrates_a_ramp_exactly(scale):
    picture = np.linspace(0, 1, 200)[:, None] + np.linspace(0, 2, 240)
    frame = render(picture, np.eye(3)[None], (24, 32), scale, psf_sigma=0.5)[0]
    x, y = grid((24, 32))
    np.testing.assert_allclose(frame, 1.5 + scale * (y / 199 + 2 * x / 239), atol=1e-12)


def test_a_pixel_is_a_box_one_pixel_wide():
    """The mean of a parabola over a unit box is its value in the centre plus 1/12."""
    u = np.arange(161) - 80.0
    frame = render(np.broadcast_to(u**2, (161, 161)), np.eye(3)[None], (21, 21), scale=2.0)[0]
    x, _ = grid((21, 21))
    np.testing.assert_allclose(frame, np.broadcast_to(4 * (x**2 + 1 / 12), frame.shape), rtol=1e-9)


def test_a_point_keeps_its_energy_and_is_as_wide_as_optics_and_pixel():
    picture = np.zeros((201, 201))
    picture[100, 100] = 1.0
    frame = render(picture, np.eye(3)[None], (41, 41), scale=4.0, psf_sigma=1.0)[0]
    x, _ = grid((41, 41))
    assert frame.sum() == pytest.approx(1 / 4.0**2, rel=1e-3)  # a picture px is a sixteenth of a pixel's area
    assert (frame * x**2).sum() / frame.sum() == pytest.approx(1.0 + 1 / 12, rel=0.002)  # the spline adds none


@pytest.mark.parametrize("model", MODELS)
def test_warps_pull_about_the_frames_centre(model):
    """frame_k(p) = scene(T_k p), checked on waves known everywhere."""
    fine, scale, shape = (500, 560), 4.0, (64, 80)

    def waves(x, y):
        return 0.5 + 0.2 * np.sin(0.11 * x + 0.05 * y) + 0.2 * np.cos(0.07 * y - 0.04 * x)

    picture = waves(*(g / scale for g in grid(fine)))
    settings = clean(shape=shape, scale=scale, motion=model, max_rotation=0.0 if model == "shift" else 8.0)
    result = simulate(picture, settings, seed=3)
    x, y = grid(shape)
    sub = (np.arange(8) - 3.5) / 8
    for frame, T in zip(result.frames, result.truth.motion, strict=True):
        expected = np.zeros(shape)
        for u, v in ((u, v) for u in sub for v in sub):
            X, Y, W = (row[0] * (x + u) + row[1] * (y + v) + row[2] for row in T)
            expected += waves(X / W, Y / W) / 64
        np.testing.assert_allclose(frame, expected, atol=2e-5)


def test_positive_angles_turn_x_towards_y():
    motion = simulate(settings=clean(max_rotation=6.0, max_shift=0.0, n_frames=9, shape=(32, 32))).truth.motion
    angle = np.arctan2(motion[:, 1, 0], motion[:, 0, 0])
    np.testing.assert_allclose(motion[:, 0, 1], -np.sin(angle))
    assert np.ptp(np.rad2deg(angle)) > 4
    assert np.abs(np.rad2deg(angle)).max() <= 6


@pytest.mark.parametrize("factor", [2, 3])
def test_a_finer_truth_averages_to_what_the_detector_sees(factor):
    sim = simulate(settings=clean(shape=(32, 40), factor=factor, psf_sigma=0.4), seed=2)
    assert sim.truth.scene.shape == (32 * factor, 40 * factor)
    blocks = block_reduce(sim.truth.scene, (factor, factor), np.mean)
    np.testing.assert_allclose(blocks, sim.frames[0], atol=2e-4)
    np.testing.assert_array_equal(
        simulate(settings=clean(shape=(32, 40), scale=6.0), seed=2).frames,
        simulate(settings=clean(shape=(32, 40), scale=6.0, factor=factor), seed=2).frames,
    )


@pytest.mark.parametrize("model", MODELS)
def test_frame_zero_is_the_reference_and_jitter_can_be_along_one_axis(model):
    for axis, other in (("x", 1), ("y", 0)):
        motion = simulate(settings=clean(motion=model, shape=(32, 32), jitter=axis)).truth.motion
        np.testing.assert_array_equal(motion[0], np.eye(3))
        np.testing.assert_array_equal(motion[:, 2, 2], 1)
        assert model == "homography" or not motion[:, other, 2].any()


# ---- blurs ----


def moments(kernel):
    """Variances along x and y, and their covariance, detector px."""
    at = (np.arange(len(kernel)) - len(kernel) // 2) / PSF_SAMPLES_PER_PIXEL
    x, y = np.meshgrid(at, at)
    return [(kernel * each).sum() for each in (x * x, y * y, x * y)]


def test_an_airy_pattern_is_dark_at_its_first_ring_and_has_its_full_width():
    assert airy(np.array([0.0, 2.0]), 2.0) == pytest.approx([1, 0], abs=1e-12)
    assert airy(np.array([1.029 / 2.44 * 2.0]), 2.0) == pytest.approx(0.5, abs=2e-3)  # 1.029 λ N


@pytest.mark.parametrize(
    ("blur", "variances"),
    [
        ({"defocus_radius": 3.0}, (9 / 4, 9 / 4, 0)),  # a quarter of a disc's squared radius
        ({"motion_blur": 6.0, "motion_blur_angle": 30.0}, (9 / 4, 3 / 4, 3 * np.sqrt(3) / 4)),  # a twelfth
        ({"defocus_radius": 2.0, "psf_sigma": 1.0}, (2, 2, 0)),  # they add
    ],
)
def test_blurs_have_the_variances_of_their_shapes(blur, variances):
    assert moments(psf(clean(**blur))) == pytest.approx(variances, abs=0.06)


def test_a_sharp_truth_is_what_the_camera_sees_without_its_optics():
    blurred = simulate(settings=clean(n_frames=1, shape=(24, 32), sharp=True, defocus_radius=2.0, scale=3.0), seed=1)
    clear = simulate(settings=clean(n_frames=1, shape=(24, 32), scale=3.0), seed=1)
    assert blurred.truth.scene.shape == (24, 32)
    assert blurred.frames[0].std() < blurred.truth.scene.std()
    assert clear.truth.psf.max() == pytest.approx(1)


# ---- parallax and stray flux ----


FLAT = {"n_frames": 3, "shape": (64, 80), "max_shift": 6.0, "psf_sigma": 0.5}


def test_frames_are_the_scene_where_the_flow_says_they_look():
    sim = simulate(None, clean(**FLAT, parallax=3.0), seed=1)
    y, x = np.mgrid[:64, :80]
    for frame, (along_x, along_y) in zip(sim.frames[1:], sim.truth.flow[1:], strict=True):
        at = np.stack((y + along_y, x + along_x))
        seen = ((at > 3) & (at < np.array([60, 76])[:, None, None])).all(0)
        expected = ndimage.map_coordinates(sim.truth.scene, at, order=3)
        flat = ndimage.map_coordinates(sim.truth.scene, [y + along_y.mean(), x + along_x.mean()], order=3)
        error, without = (np.abs(each - frame)[seen].mean() for each in (expected, flat))
        assert error < 0.003  # a pixel's box is not quite that of a pixel which is moved
        assert error < without / 5


def test_parallax_is_in_proportion_to_the_shift_and_along_it():
    sim = simulate(None, clean(**FLAT, parallax=3.0), seed=1)
    flat = simulate(None, clean(**FLAT), seed=1)
    beside = sim.truth.flow - flat.truth.flow
    shift = flat.truth.motion[:, :2, 2]
    assert np.allclose(flat.truth.flow, shift[:, :, None, None])
    assert not beside[0].any()
    for away, toward in zip(beside[1:], shift[1:], strict=True):
        share = away / (3.0 * toward[:, None, None] / 6.0)  # the nearness
        assert np.allclose(share[0], share[1])
        assert share.min() >= 0
        assert 0.5 < share.max() <= 1.001


def test_parallax_that_cannot_be_is_refused():
    with pytest.raises(ConfigError, match="hide each other"):
        simulate(None, clean(**FLAT, parallax=4.0))
    with pytest.raises(ConfigError, match="does not shift"):
        simulate(None, clean(**FLAT | {"parallax": 1.0, "max_shift": 0.0}))


@pytest.mark.parametrize("shape", ["smooth", "radial", "ring", "edge"])
def test_stray_flux_is_added_in_front_of_the_sensor(shape):
    """The scene's level holds its mean, so that it has none of its own; the gain acts on both."""
    dark, lit = (
        simulate(settings=clean(**FLAT, stray=stray, stray_shape=shape, gain_pixel=0.1), seed=4) for stray in (0.0, 0.7)
    )
    truth = lit.truth
    assert np.ptp(truth.stray) == pytest.approx(0.7)
    assert truth.stray.mean() == pytest.approx(0, abs=1e-12)
    level = truth.scene - dark.truth.scene
    assert np.ptp(level) < 1e-12
    added = np.broadcast_to(truth.gain * (truth.stray + level.mean()), lit.frames.shape)
    np.testing.assert_allclose(lit.frames - dark.frames, added, atol=1e-6)
