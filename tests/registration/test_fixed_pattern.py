"""Strong patterns, few photons, flickering pixels: the pattern does not bias the motion."""

import numpy as np
import pytest
import scipy.ndimage
import torch
from hypothesis import given
from hypothesis import settings as settings_of_hypothesis
from hypothesis import strategies as st
from registered import FAINT, SHAPE, errors, simulated

from deepir.registration import register
from deepir.registration.preprocess import variance_stabilise
from deepir.simulate import Settings, simulate
from deepir.simulate.scenes.procedural import load_picture as scene


@pytest.mark.parametrize("name", ["camera", "moon", "gravel", "astronaut", "grass"])
def test_a_pattern_four_times_the_scenes_contrast_is_seen_through(name):
    frames, truth = simulated(name, **FAINT)
    result = register(frames)
    assert result.used.all()
    assert errors(result, truth).max() < 0.7


@pytest.mark.parametrize(
    "camera",
    [
        {"gain_column": 0.5, "gain_distribution": "uniform", "gain_pixel": 0.0},
        {"gain_pixel": 0.1},
        {"photons": 150.0},
    ],
)
def test_half_the_gain_in_columns_a_tenth_in_pixels_or_few_photons_do_no_harm(camera):
    for name in ("camera", "grass"):
        frames, truth = simulated(name, **camera)
        result = register(frames)
        assert result.used.all()
        assert errors(result, truth).max() < 0.35


@given(
    gain=st.floats(0.02, 0.1),
    offset=st.floats(0.0, 0.1),
    seed=st.integers(0, 99),
    unit=st.sampled_from([1.0, 1500.0]),
)
@settings_of_hypothesis(max_examples=20, deadline=None)
def test_a_pattern_is_as_strong_in_the_bright_as_in_the_dark_once_it_is_even(gain, offset, seed, unit):
    rng = np.random.default_rng(seed)
    flux = np.tile(np.linspace(0.1, 1.5, 160), (128, 1))
    frame = flux * (1 + gain * rng.normal(size=flux.shape)) + offset * rng.normal(size=flux.shape)
    bent = variance_stabilise(torch.from_numpy(unit * frame)[None], torch.ones(128, 160))[0].numpy()
    fine = bent - scipy.ndimage.gaussian_filter(bent, 3)
    dark, bright = fine[:, :60].std(), fine[:, 100:].std()
    assert 0.6 < bright / dark < 1.6


@pytest.mark.parametrize("settings", [{}, FAINT], ids=["unit", "faint"])
def test_a_burst_that_stands_still_is_found_still(settings):
    frames, _ = simulated("camera", **settings, n_frames=1)
    noise = 0.01 * frames.std() * torch.randn(5, *SHAPE)
    result = register(frames + noise)
    assert result.used.all()
    assert torch.equal(result.motion, torch.eye(3, dtype=torch.float64).expand(5, 3, 3))


@pytest.mark.parametrize("name", ["camera", "moon", "astronaut"])
@pytest.mark.parametrize("seed", [5, 6])
def test_pixels_that_flicker_do_not_set_a_still_burst_in_motion(name, seed):
    settings = Settings(n_frames=5, shape=(120, 160), counts=True, max_shift=0.0)
    found = simulate(scene(name), settings, seed=seed)
    result = register(torch.from_numpy(found.frames.astype(np.float32)))
    assert np.abs((result.motion.numpy() - np.eye(3))[result.used.numpy()]).max() < 0.1
