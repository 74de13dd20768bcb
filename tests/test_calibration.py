"""What a camera's pattern is found from, and how it is taken out of a recording."""

import numpy as np
import pytest

from deepir import calibration
from deepir.calibration import CorrectionMaps
from deepir.errors import DataError

SHAPE = (48, 64)


@pytest.fixture
def camera():
    """Gain, offset and bad pixels, and what it makes of flux."""
    rng = np.random.default_rng(5)
    gain = 1 + 0.03 * rng.standard_normal(SHAPE) + 0.01 * rng.standard_normal(SHAPE[1])
    offset = 40 * rng.standard_normal(SHAPE)
    bad = np.zeros(SHAPE, bool)
    bad[4, 5], bad[20, 30:33], bad[0, 0], bad[40:45, 50:55] = True, True, True, True
    gain, offset = gain / gain[~bad].mean(), offset - offset[~bad].mean()

    def see(flux, count=20):
        noise = 4 * rng.standard_normal((count, *SHAPE))
        return np.where(bad, 0, gain * flux + offset + noise)

    return gain, offset, bad, see


@pytest.fixture
def scene():
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return 8000 + 300 * np.sin(x / 9) + 200 * np.cos(y / 7)


def mean_flats(see, *levels):
    """Means of twenty frames of uniform sources."""
    return [calibration.mean_frame(see(level), "flat") for level in levels]


def test_two_flats_give_gain_and_offset_and_many_agree_better(camera):
    gain, _, bad, see = camera
    means = mean_flats(see, 7000, 7000, 7000, 9000, 9000, 9000)
    two, many = (calibration.maps_from_flats(flats) for flats in (means[2:4], means))
    np.testing.assert_array_equal(two.bad_pixels, bad)
    errors = [np.std((found.gain - gain)[~bad]) for found in (two, many)]
    assert errors[0] < 0.002
    assert errors[1] < 0.7 * errors[0]
    assert two.gain[~bad].mean() == pytest.approx(1, abs=1e-6)
    assert two.offset[~bad].mean() == pytest.approx(0, abs=1e-2)


def test_one_flat_takes_away_all_of_the_pattern_at_its_temperature(camera):
    _, _, bad, see = camera
    found = calibration.maps_from_flats(mean_flats(see, 8000))
    corrected = found.correct(see(8000, 1)[0])
    assert (found.gain == 1).all()
    assert np.std(corrected[~bad]) == pytest.approx(4, rel=0.1)  # the noise


def test_the_recording_is_the_scene_and_noise(camera, scene):
    gain, offset, bad, see = camera
    corrected = CorrectionMaps(gain, offset, bad).correct(see(scene))
    assert corrected.dtype == np.float32
    error = corrected - scene
    assert np.std(error[:, ~bad]) == pytest.approx(4, rel=0.05)
    assert abs(error[:, ~bad].mean()) < 0.1


def test_bad_pixels_are_the_mean_of_their_good_neighbours():
    bad = np.zeros(SHAPE, bool)
    bad[10, 10], bad[0, 0], bad[20:25, 20:25] = True, True, True
    ramp = np.add.outer(np.arange(SHAPE[0]), 100 * np.arange(SHAPE[1])).astype(float)
    seen = np.where(bad, np.nan, ramp)
    mended = CorrectionMaps(np.ones(SHAPE), np.zeros(SHAPE), bad).correct(seen)
    assert mended[10, 10] == pytest.approx(ramp[10, 10])
    assert mended[0, 0] == pytest.approx((1 + 100 + 101) / 3)
    assert mended[22, 22] in ramp[19:26, 19:26]  # none is near: the nearest
    np.testing.assert_array_equal(mended[~bad], ramp[~bad].astype(np.float32))


def test_masked_samples_become_nan():
    frame = np.ma.masked_array(np.ones(SHAPE, np.uint8), np.zeros(SHAPE, bool))
    frame[3, 4] = np.ma.masked
    corrected = CorrectionMaps(np.ones(SHAPE), np.zeros(SHAPE), np.zeros(SHAPE, bool)).correct(frame)
    assert np.argwhere(np.isnan(corrected)).tolist() == [[3, 4]]


def test_pixels_that_cannot_be_divided_by_are_bad(tmp_path):
    gain, offset = np.ones(SHAPE), np.zeros(SHAPE)
    gain[1, 1], gain[2, 2], offset[3, 3] = 0, np.nan, np.inf
    np.savez(tmp_path / "maps.npz", gain=gain, offset=offset)
    found = calibration.read_maps(tmp_path / "maps.npz")
    assert np.argwhere(found.bad_pixels).tolist() == [[1, 1], [2, 2], [3, 3]]
    assert np.isfinite(found.correct(np.ones(SHAPE))).all()


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"gain": np.ones(SHAPE)}, "no offset; maps are made by"),
        ({"gain": np.ones(SHAPE), "offset": np.ones((2, 2))}, "differ in size"),
        ({"gain": np.zeros(SHAPE), "offset": np.zeros(SHAPE)}, "not one pixel has a gain above zero"),
    ],
)
def test_files_without_valid_maps_are_refused(tmp_path, arrays, message):
    np.savez(tmp_path / "maps.npz", **arrays)
    with pytest.raises(DataError, match=message):
        calibration.read_maps(tmp_path / "maps.npz")


def test_frames_that_maps_cannot_correct_and_flats_of_one_temperature_are_refused(camera):
    _, _, _, see = camera
    with pytest.raises(DataError, match="the frames are 9 x 9 px, the maps 48 x 64 px"):
        CorrectionMaps(np.ones(SHAPE), np.zeros(SHAPE), np.zeros(SHAPE, bool)).correct(np.ones((9, 9)))
    with pytest.raises(DataError, match="two temperatures are needed"):
        calibration.maps_from_flats(mean_flats(see, 8000, 8000))


def test_a_pixel_without_a_value_in_one_flat_is_bad(camera):
    _, _, bad, see = camera
    flats = mean_flats(see, 7000, 9000)
    flats[1][7, 7] = np.nan
    assert np.argwhere(calibration.maps_from_flats(flats).bad_pixels & ~bad).tolist() == [[7, 7]]
    with pytest.raises(DataError, match="no pixel has a value"):
        calibration.maps_from_flats([np.full(SHAPE, np.nan)])


@pytest.mark.parametrize("end", [0, 2**14 - 1])
def test_what_is_at_an_end_of_the_range_in_all_flats_is_bad(end):
    rng = np.random.default_rng(3)
    frames = (8000 * (1 + 0.17 * rng.standard_normal((4, *SHAPE))[:1]) + rng.standard_normal((4, *SHAPE))).round()
    frames[:, 5::9, 3::11] = end
    found = calibration.maps_from_flats([calibration.mean_frame(frames, "flat")]).bad_pixels
    assert found[5::9, 3::11].all()
    assert found.sum() <= found[5::9, 3::11].size + 1


def test_maps_come_back_from_their_file_and_those_of_a_run_hold_its_stray_flux(tmp_path, camera):
    gain, offset, bad, _ = camera
    CorrectionMaps(gain.astype(np.float32), offset.astype(np.float32), bad).save(tmp_path / "maps.npz")
    found = calibration.read_maps(tmp_path / "maps.npz")
    np.testing.assert_allclose(found.gain, gain, rtol=1e-6)
    np.testing.assert_allclose(found.offset[~bad], offset[~bad], rtol=1e-5)
    np.testing.assert_array_equal(found.bad_pixels, bad)
    stray, flux = np.random.default_rng(4).uniform(0, 300, (2, *SHAPE))
    np.savez(tmp_path / "result.npz", gain=gain, offset=offset, stray=stray)
    seen = gain * (flux + stray) + offset
    np.testing.assert_allclose(calibration.read_maps(tmp_path).correct(seen), flux, atol=0.01)


def test_maps_of_another_camera_or_of_other_units_roughen_a_frame(camera, scene):
    _, _, _, see = camera
    found = calibration.maps_from_flats(mean_flats(see, 7000, 9000))
    frame = see(scene, 1)[0]
    assert found.roughness_ratio(frame) < 0.3
    assert found.roughness_ratio(scene + 40 * np.random.default_rng(9).standard_normal(SHAPE)) > 1.3
    assert found.roughness_ratio(frame / 50 + 200) > 5
    for nothing in (8000.0, np.nan):
        assert found.roughness_ratio(np.full(SHAPE, nothing)) == 1.0


def test_frames_of_a_scene_are_no_flats():
    rng = np.random.default_rng(8)
    scenes = [8000 + 300 * rng.standard_normal(SHAPE) for _ in range(2)]
    with pytest.raises(DataError, match=r"\d+% of the pixels answer unlike the others.*--burst"):
        calibration.maps_from_flats([scenes[0], scenes[1] + 100])
