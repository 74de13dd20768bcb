"""Offsets from gradients: medians over many frames."""

import numpy as np
import pytest

import deepir
from deepir.baselines.gradients import multiview_tv, multiview_tv_recursive
from deepir.simulate import Settings, simulate


@pytest.fixture(scope="module")
def sim():
    """Forty frames of 48 x 64 px, whose sensor has an offset only."""
    offsets = {"gain_pixel": 0.0, "gain_column": 0.0, "shading": 0.0, "dead_pixels": 0.0}
    return simulate(settings=Settings(n_frames=40, shape=(48, 64), own_scenes=True, **offsets), seed=1)


def likeness(first, second):
    return np.corrcoef(first.ravel(), second.ravel())[0, 1]


def test_where_most_frames_are_flat_the_offset_is_exact_and_the_others_do_not_matter():
    rng = np.random.default_rng(0)
    offset = rng.normal(size=(17, 22))
    frames = offset + np.arange(5.0)[:, None, None]
    np.testing.assert_allclose(multiview_tv(frames), offset - offset.mean(), atol=1e-10)
    frames[1], frames[4] = rng.normal(size=(2, 17, 22))
    np.testing.assert_allclose(multiview_tv(frames), offset - offset.mean(), atol=1e-10)


def test_a_frame_at_a_time_comes_closer_with_each(sim):
    found = [likeness(multiview_tv_recursive(sim.frames[:n]), sim.truth.offset) for n in (1, 10, 40)]
    assert found[0] < found[1] < found[2]
    assert found[2] > 0.9


@pytest.mark.parametrize("method", ["multiview_tv", "multiview_tv_recursive"])
def test_scenes_are_the_frames_without_the_offset(sim, method):
    result = deepir.run("multiview_nuc", frames=sim.frames, method=method)
    np.testing.assert_allclose(result.scene, sim.frames - result.offset, atol=1e-5)
    # Slow slopes, which many of the scenes have in common, it takes for the sensor's.
    assert likeness(np.diff(result.offset), np.diff(sim.truth.offset)) > 0.9
    assert np.all(result.gain == 1)
