"""The level about which gain turns is found by evidence, and gain and offset are right on every kind of camera.

Strengths of the pattern are right, too, under noise that is neither white nor fine.
"""

import numpy as np
import pytest
import torch
from pedestal import NOISE, OFFSET, PEDESTAL, SIZE, camera
from scipy import ndimage

import deepir
from deepir.errors import ConfigError
from deepir.estimation.variance_components import reference_level_nats


@pytest.mark.parametrize("level", [0.0, 0.5 * PEDESTAL, PEDESTAL], ids=["raw", "between", "after a shutter"])
def test_the_level_is_found_and_gain_and_offset_are_as_sure_as_they_say(level):
    frames, gain, offset = camera(level)
    result = deepir.run("nuc", frames=np.round(frames).astype(np.uint16))
    assert result.metrics["reference_level"] == pytest.approx(level, abs=0.1 * PEDESTAL)
    assert np.corrcoef(result.gain.ravel(), gain.ravel())[0, 1] > 0.45
    assert np.median(np.abs(result.gain * result.scene + result.offset - frames[0])) < 1.5 * NOISE
    assert frames.min() > 0.8 * PEDESTAL  # they are not changed
    for found, true, deviation in (
        (result.gain, gain, result.uncertainty["gain"]),
        (result.offset, offset, result.uncertainty["offset"]),
    ):
        error = found - true
        error = np.abs(error - np.median(error))
        assert 0.5 < np.mean(error < deviation) < 0.95
        assert np.mean(error < 2 * deviation) > 0.8


def test_a_level_that_is_given_is_kept():
    frames, gain, _ = camera(PEDESTAL)
    result = deepir.run("nuc", "physics.sensor.reference=0", frames=np.round(frames).astype(np.uint16))
    assert result.metrics["reference_level"] == 0
    assert abs(np.corrcoef(result.gain.ravel(), gain.ravel())[0, 1]) < 0.3


@pytest.mark.parametrize(("given", "said"), [("1e30", "the data are"), (".nan", "a level in the data's units")])
def test_a_level_that_is_none_of_the_data_is_refused(given, said):
    frames, _, _ = camera(PEDESTAL)
    with pytest.raises(ConfigError, match=said):
        deepir.run("nuc", f"physics.sensor.reference={given}", frames=np.round(frames).astype(np.uint16))


def test_the_likelihood_of_the_level_is_largest_at_the_true_one():
    rng = np.random.default_rng(1)
    count, level = 4000, 300.0
    gain, rest = 0.03 * rng.standard_normal(count), 5 * rng.standard_normal(count)
    signal = 320 + 60 * rng.standard_normal((8, count))
    observed = gain * signal + rest - level * gain + rng.standard_normal((8, count))
    aa, ab, bb = (signal**2).sum(0), signal.sum(0), np.full(count, 8.0)
    score = np.stack(((signal * observed).sum(0), observed.sum(0)))
    sigma = np.array([0.03, 9.0])
    means = np.linalg.solve(
        np.moveaxis(np.array([[aa + sigma[0] ** -2, ab], [ab, bb + sigma[1] ** -2]]), 2, 0), score.T[..., None]
    )[..., 0].T
    given = torch.from_numpy(np.stack((aa, ab, bb))), torch.from_numpy(means), torch.from_numpy(sigma)
    nats = {each: reference_level_nats(*given, each) for each in (0.0, 200.0, 300.0, 400.0)}
    assert min(nats, key=nats.get) == 300.0
    assert nats[0.0] > nats[300.0] + 20


def white():
    return NOISE * np.random.default_rng(1).standard_normal((12, *SIZE))


def coloured():
    each = ndimage.gaussian_filter(white(), (0, 0.8, 0.8))[4:]
    return NOISE * each / each.std()


def filtered_in_time():
    """Of a camera that gives the mean of each three frames."""
    noise = white()
    return (noise[4:] + noise[3:-1] + noise[2:-2]) / 3**0.5


@pytest.mark.parametrize(
    ("noise", "step"), [(coloured, 1.0), pytest.param(coloured, 16.0, marks=pytest.mark.slow), (filtered_in_time, 1.0)]
)
def test_pixels_are_as_strong_as_they_are(noise, step):
    frames, _, _ = camera(PEDESTAL, noise())
    frames = (step * np.round(frames / step)).astype(np.float32)
    found = deepir.run("nuc", frames=frames).metrics["strengths"]
    assert found["offset.pixel.sigma"] == pytest.approx(OFFSET, rel=0.15)
