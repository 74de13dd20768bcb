"""Calibration with uniform sources."""

import numpy as np
import pytest

import deepir
from deepir.errors import ConfigError, DataError
from deepir.simulate import Settings, simulate


@pytest.fixture(scope="module")
def camera():
    settings = Settings(n_frames=4, shape=(40, 48), max_shift=4.0, gain_pixel=0.1, dead_pixels=0.0)
    return simulate(None, settings, seed=2)


@pytest.fixture
def flats(camera, tmp_path):
    """Five frames of each uniform source."""
    rng, truth = np.random.default_rng(0), camera.truth
    for name, flux in {"shutter": 0.4, "cold": 0.1, "hot": 0.9}.items():
        noise = truth.read_noise * rng.standard_normal((5, 40, 48))
        np.save(tmp_path / f"{name}.npy", (truth.gain * flux + truth.offset + noise).astype(np.float32))
    return {name: str(tmp_path / f"{name}.npy") for name in ("shutter", "cold", "hot")}


def run(camera, **options):
    return deepir.run("nuc", frames=camera.frames, method={"type": "flat_field", **options})


def test_two_black_bodies_give_gain_and_offset(camera, flats):
    result = run(camera, cold=flats["cold"], hot=flats["hot"])
    assert np.abs(result.gain - camera.truth.gain).max() < 0.02
    assert np.abs(result.offset - camera.truth.offset).max() < 0.02
    assert np.abs(result.scene - camera.truth.scene).std() < 0.01


def test_a_shutter_gives_the_pattern_at_its_own_level(camera, flats):
    result = run(camera, shutter=flats["shutter"])
    pattern = (camera.truth.gain - 1) * 0.4 + camera.truth.offset
    assert np.array_equal(result.gain, np.ones((40, 48)))
    assert np.abs(result.offset - pattern).max() < 0.01


def test_a_shutter_after_the_black_bodies_brings_the_offset_up_to_date(camera, flats, tmp_path):
    drift = 0.2 * np.random.default_rng(1).standard_normal((1, 40, 48))
    np.save(tmp_path / "now.npy", np.load(flats["shutter"]) + drift)
    result = run(camera, **flats | {"shutter": str(tmp_path / "now.npy")})
    wanted = camera.truth.offset + drift[0] - drift.mean()
    assert np.abs(result.gain - camera.truth.gain).max() < 0.02
    assert np.abs(result.offset - wanted).max() < 0.02


def test_errors_say_what_to_give(camera, flats, tmp_path):
    with pytest.raises(ConfigError, match=r"give flat frames: method\.shutter=FILE"):
        run(camera)
    with pytest.raises(ConfigError, match=r"method\.cold=FILE method\.hot=FILE"):
        run(camera, hot=flats["hot"])
    with pytest.raises(DataError, match=r"two temperatures are needed"):
        run(camera, cold=flats["hot"], hot=flats["hot"])
    np.save(tmp_path / "small.npy", np.ones((2, 30, 48)))
    with pytest.raises(DataError, match=r"30 x 48 px \(method\.shutter\), the burst's have 40 x 48"):
        run(camera, shutter=str(tmp_path / "small.npy"))
