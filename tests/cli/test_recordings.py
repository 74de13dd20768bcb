"""`deepir calibrate` and `deepir apply`, and files that need settings to be read."""

import json

import numpy as np
import pytest
import recordings
import scipy.io
from PIL import Image

from deepir.calibration import CorrectionMaps
from deepir.io import read_frames
from deepir.io.radiometry import Planck


@pytest.fixture
def maps(folder, burst):
    """The simulated camera's true maps, in `maps.npz`."""
    truth = burst.truth
    true = CorrectionMaps(truth.gain.astype(np.float32), truth.offset.astype(np.float32), truth.bad_pixels)
    true.save(folder / "maps.npz")
    return true


def test_a_recording_is_corrected_in_its_type_and_says_what_it_is(deepir, folder, burst, maps):
    recordings.seq(folder / "flight.seq", burst.frames)
    status, out, err = deepir("apply", "maps.npz", "flight.seq")
    assert (status, err) == (0, "")
    assert "flight_corrected.tif: 3 frame(s) of 40 x 48 px" in out
    corrected = read_frames("flight_corrected.tif")
    assert corrected.dtype == "uint16"
    assert isinstance(corrected.radiometry, Planck)
    np.testing.assert_array_equal(corrected.frames, np.rint(maps.correct(burst.frames)))


def test_true_maps_leave_the_scene_and_noise(deepir, folder, burst, maps):
    assert deepir("apply", "maps.npz", "burst.npz", "--float32", "--output", "a.tif")[0] == 0
    corrected = read_frames("a.tif")
    assert corrected.dtype == "float32"
    error = corrected.frames[0] - burst.truth.scene
    assert np.std(error) < 0.1 * np.std(burst.frames[0] - burst.truth.scene)


def test_the_folder_of_a_run_has_maps_and_its_warnings_are_repeated(deepir, folder, burst):
    assert deepir("run", "nuc", "data.path=burst.npz", "solver.max_iterations=5")[0] == 0
    metrics, warning = folder / "runs/nuc/metrics.json", "warning[motion-small]: the frames hardly move"
    metrics.write_text(json.dumps(json.loads(metrics.read_text()) | {"messages": [warning]}))
    status, _, err = deepir("apply", "runs/nuc", "burst.npz", "--output", "a.tif")
    assert status == 0
    assert f"runs/nuc: {warning}" in err
    before, after = (np.std(frame - burst.truth.scene) for frame in (burst.frames[0], read_frames("a.tif").frames[0]))
    assert after < 0.5 * before


def test_calibrate_finds_maps_in_flats(deepir, folder, burst, maps):
    gain, offset = burst.truth.gain, burst.truth.offset
    rng = np.random.default_rng(2)
    for name, level in (("cold", 7500), ("hot", 9500)):
        flats = gain * level + offset + 4 * rng.standard_normal((30, *gain.shape))
        np.savez(folder / f"{name}.npz", flats=flats.round().astype(np.uint16), time=np.arange(30))
    status, out, err = deepir("calibrate", "found.npz", "cold.npz", "hot.npz", "data.key=flats")
    assert (status, err) == (0, "")
    assert "found.npz: gain σ 3." in out
    assert "deepir apply found.npz FILE" in out
    assert deepir("apply", "found.npz", "burst.npz")[0] == 0
    expected = maps.correct(burst.frames)
    assert np.std(read_frames("burst_corrected.tif").frames - expected) < 5


def test_calibrate_finds_maps_in_a_moving_burst(deepir, folder, burst):
    status, out, _ = deepir("calibrate", "--burst", "found.npz", "burst.npz", "solver.max_iterations=5")
    assert status == 0
    assert "gain σ" in out
    assert not (folder / "runs").exists()
    with np.load("found.npz") as found:
        assert np.corrcoef(found["offset"].ravel(), burst.truth.offset.ravel())[0, 1] > 0.5


def test_a_film_is_written(deepir, folder, maps):
    pytest.importorskip("av")
    settings = ("output.palette=inferno", "output.tones=clahe")
    assert deepir("apply", "maps.npz", "burst.npz", "--output", "a.mp4", *settings)[0] == 0
    assert (folder / "a.mp4").stat().st_size > 500


def test_a_file_without_a_header_is_described(deepir, folder, burst):
    (folder / "a.y16").write_bytes(burst.frames.tobytes())
    status, out, err = deepir("check", "a.y16", "data.raw={width: 48, height: 40}", "data.radiometry.scale=0.04")
    assert (status, err) == (0, "")
    assert "3 frame(s) of 40 x 48 px (height x width), stored as uint16" in out
    assert "°C by 0.04 K a count" in out
    assert "deepir run nuc data.path=a.y16 'data.raw={width: 48, height: 40}' data.radiometry.scale=0.04" in out


def test_lepton_counts_are_recognised(deepir, folder):
    np.save(folder / "a.npy", np.random.default_rng(0).integers(29000, 30000, (2, 20, 20), np.uint16))
    assert "if these are K x 100 (TLinear): data.radiometry.scale=0.01" in deepir("check", "a.npy")[1]


def test_a_radiometric_run_writes_what_output_asks_for_and_says_how_warm_the_scene_is(deepir, folder):
    wanted = ("output.mat=true", "output.palette=ironbow", "output.tones=clahe", "data.radiometry.scale=0.04")
    status, out, _ = deepir("run", "nuc", "data.path=burst.npz", "method=average", *wanted)
    assert status == 0
    with Image.open("runs/nuc/scene_preview.png") as picture:
        assert picture.mode == "RGB"
    stored = scipy.io.loadmat("runs/nuc/result.mat")
    with np.load("runs/nuc/result.npz") as arrays:
        np.testing.assert_array_equal(stored["scene"], arrays["scene"])
        assert set(arrays) <= set(stored)
        low, high = arrays["scene_kelvin"].min() - 273.15, arrays["scene_kelvin"].max() - 273.15
    assert f"temperatures {low:.2f} to {high:.2f} °C: runs/nuc/scene_kelvin.tiff" in out


def test_a_burst_that_stands_still_is_corrected_only_if_it_moved(deepir, folder):
    frames = np.random.default_rng(0).normal(8000, 50, (64, 80)) * np.ones((4, 1, 1))
    np.save("still.npy", frames + np.random.default_rng(1).normal(0, 5, frames.shape))
    out = deepir("check", "still.npy")[1]
    assert "motion: none detected" in out
    assert "if it moved all the same: deepir run nuc data.path=still.npy" in out
