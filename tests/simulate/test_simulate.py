"""What a simulated burst must obey, whatever the camera."""

import dataclasses
import json

import numpy as np
import pytest
from skimage.measure import block_reduce

from deepir.errors import ConfigError, DataError
from deepir.simulate import ADC_MAX, Settings, render, simulate

IDEAL = Settings(
    **dict.fromkeys(
        ["gain_pixel", "gain_column", "offset_pixel", "offset_column", "offset_row", "shading", "read_noise"],
        0.0,
    ),
    dead_pixels=0.0,
    psf_sigma=0.0,
)
PATTERN = Settings(gain_row=0.02, gain_column=0.1, level_drift=0.05, dead_pixels=0.01, shape=(40, 56))
MODELS = ["shift", "rigid", "affine", "homography"]


def ideal(**changes: object) -> Settings:
    return dataclasses.replace(IDEAL, **changes)


def grid(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """(x, y) of the pixel centres, from the frame's centre."""
    y, x = (np.arange(n) - (n - 1) / 2 for n in shape)
    return x[None, :], y[:, None]


def shift(x: float, y: float) -> np.ndarray:
    return np.array([[1, 0, x], [0, 1, y], [0, 0, 1.0]])


# ---- geometry ----


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


def test_blur_and_pixel_keep_the_energy_of_a_point():
    picture = np.zeros((161, 161))
    picture[83, 78] = 1.0
    frame = render(picture, np.eye(3)[None], (41, 41), scale=3.0, psf_sigma=0.8)[0]
    assert frame.sum() == pytest.approx(1 / 3.0**2, rel=1e-3)  # a picture px is a ninth of a pixel's area


def test_the_point_spread_function_has_the_width_it_says():
    picture = np.zeros((201, 201))
    picture[100, 100] = 1.0
    frame = render(picture, np.eye(3)[None], (41, 41), scale=4.0, psf_sigma=1.0)[0]
    x, _ = grid((41, 41))
    variance = (frame * x**2).sum() / frame.sum()
    assert variance == pytest.approx(
        1.0 + 1 / 12, rel=0.002
    )  # optics and the pixel's box; the spline adds none


@pytest.mark.parametrize("model", MODELS)
def test_warps_pull_about_the_frames_centre(model):
    """frame_k(p) = scene(T_k p), checked on waves known everywhere."""
    fine, scale, shape = (500, 560), 4.0, (64, 80)

    def waves(x, y):
        return 0.5 + 0.2 * np.sin(0.11 * x + 0.05 * y) + 0.2 * np.cos(0.07 * y - 0.04 * x)

    picture = waves(*(g / scale for g in grid(fine)))
    settings = ideal(shape=shape, scale=scale, motion=model, max_rotation=0.0 if model == "shift" else 8.0)
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
    motion = simulate(
        settings=ideal(max_rotation=6.0, max_shift=0.0, n_frames=9, shape=(32, 32))
    ).truth.motion
    angle = np.arctan2(motion[:, 1, 0], motion[:, 0, 0])
    np.testing.assert_allclose(motion[:, 0, 1], -np.sin(angle))
    assert np.ptp(np.rad2deg(angle)) > 4
    assert np.abs(np.rad2deg(angle)).max() <= 6


@pytest.mark.parametrize("factor", [2, 3])
def test_a_finer_truth_averages_to_what_the_detector_sees(factor):
    sim = simulate(settings=ideal(shape=(32, 40), factor=factor, psf_sigma=0.4), seed=2)
    assert sim.truth.scene.shape == (32 * factor, 40 * factor)
    blocks = block_reduce(sim.truth.scene, (factor, factor), np.mean)
    np.testing.assert_allclose(blocks, sim.frames[0], atol=2e-4)
    np.testing.assert_array_equal(
        simulate(settings=ideal(shape=(32, 40), scale=6.0), seed=2).frames,
        simulate(settings=ideal(shape=(32, 40), scale=6.0, factor=factor), seed=2).frames,
    )


@pytest.mark.parametrize("changes", [{"factor": 0}, {"factor": 9}, {"factor": 4, "scale": 3.0}])
def test_a_truth_finer_than_the_picture_is_refused(changes):
    with pytest.raises(ConfigError, match=r"simulate\.(factor|scale)"):
        ideal(**changes)


@pytest.mark.parametrize("model", MODELS)
def test_frame_zero_is_the_reference(model):
    truth = simulate(settings=ideal(motion=model, shape=(32, 32))).truth
    np.testing.assert_array_equal(truth.motion[0], np.eye(3))
    np.testing.assert_array_equal(truth.motion[:, 2, 2], 1)


def test_jitter_can_be_along_one_axis():
    assert not simulate(settings=ideal(jitter="x", shape=(32, 32))).truth.motion[:, 1, 2].any()
    assert not simulate(settings=ideal(jitter="y", shape=(32, 32))).truth.motion[:, 0, 2].any()


# ---- pattern, units ----


@pytest.mark.parametrize("distribution", ["normal", "uniform"])
@pytest.mark.parametrize("counts", [False, True])
def test_the_truth_is_in_the_gauge(distribution, counts):
    truth = simulate(
        settings=dataclasses.replace(PATTERN, gain_distribution=distribution, counts=counts)
    ).truth
    good = ~truth.bad_pixels
    assert truth.gain[good].mean() == pytest.approx(1, abs=1e-12)
    assert truth.offset[good].mean() == pytest.approx(0, abs=1e-9)
    assert truth.level.mean() == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("counts", [False, True])
def test_without_noise_the_reference_is_gain_times_scene_plus_offset_plus_level(counts):
    result = simulate(settings=dataclasses.replace(PATTERN, counts=counts, read_noise=0.0))
    truth, good = result.truth, ~result.truth.bad_pixels
    expected = truth.gain * truth.scene + truth.offset + truth.level[0]
    np.testing.assert_allclose(result.frames[0][good], expected[good], atol=0.5 if counts else 1e-6)


def test_uniform_columns_are_those_of_the_paper():
    gain = simulate(settings=ideal(gain_distribution="uniform", gain_column=0.5, shape=(16, 400))).truth.gain
    assert not np.ptp(gain, axis=0).any()
    assert gain.min() / gain.max() == pytest.approx(0.5, abs=0.02)  # U(v, 1) with v = 0.5
    assert gain[0].std() / gain.max() == pytest.approx(0.5 / np.sqrt(12), rel=0.1)


def test_shading_has_its_peak_to_peak_and_is_smooth():
    offset = simulate(settings=ideal(shading=0.4)).truth.offset
    assert np.ptp(offset) == pytest.approx(0.4)
    assert np.abs(np.diff(offset)).max() < 0.02


def test_counts_are_fourteen_bit_integers_on_a_pedestal():
    result = simulate(settings=dataclasses.replace(PATTERN, counts=True))
    assert result.frames.dtype == np.uint16
    assert result.frames.max() == ADC_MAX  # stuck high
    assert result.frames.min() == 0  # stuck low
    assert 7900 < result.truth.scene.min() < result.truth.scene.max() < 9600


def test_the_gain_acts_on_the_pedestal():
    """In counts, one per cent of gain is 80 counts and more: far above one per cent of the scene."""
    result = simulate(settings=ideal(gain_pixel=0.01, counts=True))
    pattern = result.frames[0] - result.truth.scene
    assert pattern.std() == pytest.approx(0.01 * result.truth.scene.mean(), rel=0.05)


def test_bad_pixels_are_as_many_as_asked_and_tell_nothing():
    result = simulate(settings=dataclasses.replace(PATTERN, dead_pixels=0.03))
    assert result.truth.bad_pixels.sum() == round(0.03 * 40 * 56)
    stuck = np.ptp(result.frames, axis=0) == 0
    assert stuck.sum() == pytest.approx(2 / 3 * result.truth.bad_pixels.sum(), abs=1)
    assert not (stuck & ~result.truth.bad_pixels).any()


# ---- noise ----


@pytest.mark.parametrize("counts", [False, True])
def test_photon_noise_is_poisson(counts):
    """Mean g x and variance g x / photons_per_unit, on a flat scene."""
    settings = ideal(photons=1000.0, counts=counts, n_frames=20, shape=(64, 64))
    result = simulate(np.full((300, 300), 0.4), settings)
    expected = 8000 + 1500 * 0.4 if counts else 0.4
    variance = expected / result.truth.photons_per_unit
    assert result.frames.mean() == pytest.approx(expected, abs=5 * np.sqrt(variance / result.frames.size))
    assert result.frames.var() == pytest.approx(variance, rel=0.03)


def test_read_noise_has_its_sigma_in_the_datas_units():
    result = simulate(np.full((300, 300), 0.4), ideal(read_noise=0.004, counts=True, shape=(64, 64)))
    assert result.truth.read_noise == pytest.approx(6.0)
    assert result.frames.std() == pytest.approx(np.sqrt(6.0**2 + 1 / 12), rel=0.03)


def test_the_level_walks_at_random():
    level = simulate(settings=ideal(level_drift=0.1, n_frames=200, shape=(8, 8))).truth.level
    assert np.diff(level).std() == pytest.approx(0.1, rel=0.15)


# ---- seeds, files, errors ----


def test_the_seed_decides_everything():
    one, same, other = (simulate(settings=PATTERN, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.frames, same.frames)
    assert not np.array_equal(one.truth.motion, other.truth.motion)
    assert not np.array_equal(one.truth.gain, other.truth.gain)


def test_another_noise_keeps_motion_and_pattern():
    one = simulate(settings=PATTERN).truth
    noisy = dataclasses.replace(PATTERN, read_noise=0.1, photons=100.0, level_drift=0.0, psf_sigma=0.6)
    two = simulate(settings=noisy).truth
    for name in ("motion", "gain", "offset", "bad_pixels"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


def test_a_saved_burst_reads_without_pickle(tmp_path):
    result = simulate(settings=PATTERN, seed=5)
    path, beside = result.save(tmp_path / "burst.npz")
    assert beside == tmp_path / "burst_truth.npz"
    with np.load(path, allow_pickle=False) as data, np.load(beside, allow_pickle=False) as truth:
        np.testing.assert_array_equal(data["frames"], result.frames)
        settings = json.loads(str(data["settings"]))
        assert settings.pop("seed") == 5
        assert Settings(**{**settings, "shape": tuple(settings["shape"])}) == PATTERN
        assert set(truth) == {field.name for field in dataclasses.fields(result.truth)}
        np.testing.assert_array_equal(truth["gain"], result.truth.gain)


def test_all_frames_fit_at_the_largest_scale():
    """The chosen scale is the largest: one per cent more does not fit."""
    picture = np.full((256, 300), 0.5)
    scale = simulate(picture, ideal(shape=(96, 96))).truth.scale
    with pytest.raises(DataError):
        simulate(picture, ideal(shape=(96, 96), scale=1.01 * scale))


def test_a_picture_that_is_too_small_says_how_large_it_must_be():
    with pytest.raises(DataError, match=r"100 x 100 px is too small.*need \d+ x \d+ px.*max_shift"):
        simulate(np.full((100, 100), 0.5), ideal(shape=(96, 96)))


@pytest.mark.parametrize(
    "scene", [np.full((500, 500), 7.0), np.full((500, 500), np.nan), np.zeros((3, 500, 500))]
)
def test_a_scene_is_a_picture_between_zero_and_one(scene):
    with pytest.raises(DataError, match=r"\[0, 1\]"):
        simulate(scene, ideal())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"motion": "rigdi"}, "did you mean 'rigid'"),
        ({"jitter": "z"}, "jitter"),
        ({"read_noise": -1.0}, "read_noise"),
        ({"photons": float("nan")}, "photons"),
        ({"n_frames": 0}, "n_frames"),
        ({"scale": 1.0}, "1.2"),
        ({"motion": "shift", "max_rotation": 3.0}, "does not rotate"),
        ({"dead_pixels": 0.9}, "dead_pixels"),
        ({"dead_pixels": 0.2, "stuck_pixels": 0.2, "noisy_pixels": 0.2}, "noisy_pixels = 0.6 together"),
        ({"gain_shading": 1.5}, "gain_shading = 1.5"),
        ({"walker": 2.0}, "walker = 2.0"),
        ({"n_frames": 4, "failed_frame": 4}, "failed_frame = 4.*numbered 1 to 3"),
    ],
)
def test_wrong_settings_are_named(changes, message):
    with pytest.raises(ConfigError, match=message):
        Settings(**changes)


def test_a_simulation_is_saved_as_npz_only(tmp_path):
    with pytest.raises(DataError, match="npz"):
        simulate(settings=ideal(shape=(32, 32))).save(tmp_path / "burst.tif")
