"""A radiometric burst: the correction takes the pattern away, and leaves the temperature."""

import json

import numpy as np
import pytest
import tifffile

from deepir import run
from deepir.io import read_frames, write_tiff
from deepir.io.radiometry import Linear, unit_metadata
from deepir.simulate import Settings, simulate

SCALE = 0.04  # K a count: 288 to 308 K
CAMERA = Settings(n_frames=6, shape=(64, 80), counts=True, pedestal=7200.0, contrast=500.0, dead_pixels=0.002)


@pytest.fixture(scope="module")
def corrected(tmp_path_factory):
    burst = simulate(None, CAMERA, seed=0)
    folder = tmp_path_factory.mktemp("radiometric")
    write_tiff(folder / "burst.tif", burst.frames, unit_metadata(Linear(SCALE)))
    result = run("nuc", data={"path": folder / "burst.tif"}, output={"dir": folder / "run"})
    return burst, result, folder / "run"


def test_the_pattern_of_kelvins_goes_and_the_level_moves_by_less_than_twenty_millikelvin(corrected):
    burst, result, _ = corrected
    found, truth = result.extra["scene_kelvin"], SCALE * burst.truth.scene
    assert abs((found - truth).mean()) < 0.02
    assert abs(np.median(found - truth)) < 0.02
    inside = np.s_[8:-8, 8:-8]
    assert np.median(np.abs(SCALE * burst.frames[0] - truth)[inside]) > 3
    assert np.median(np.abs(found - truth)[inside]) < 0.1


def test_files_say_what_their_values_are(corrected):
    _, result, folder = corrected
    kelvin = read_frames(folder / "scene_kelvin.tiff")
    assert kelvin.radiometry == Linear(1.0)
    np.testing.assert_array_equal(kelvin.frames[0], result.extra["scene_kelvin"])
    counts = read_frames(folder / "scene.tiff")
    np.testing.assert_allclose(counts.radiometry.kelvin(counts.frames), kelvin.frames, rtol=1e-6)
    with tifffile.TiffFile(folder / "scene.tiff") as tiff:
        assert json.loads(tiff.pages.first.description)["unit"] == "counts"
    with np.load(folder / "result.npz") as arrays:
        np.testing.assert_array_equal(arrays["scene_kelvin"], kelvin.frames[0])
    assert json.loads((folder / "metrics.json").read_text())["radiometry"] == {"scale": SCALE, "zero": 0.0}


def test_counts_without_a_law_stay_counts(burst):
    result = run("nuc", frames=burst.frames, method="average")
    assert "scene_kelvin" not in result.extra
    assert result.metrics["radiometry"] is None
