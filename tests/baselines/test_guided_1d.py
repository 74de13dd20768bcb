"""Guided filters along rows and columns."""

import numpy as np

from deepir.baselines.single_frame.guided_1d import estimate_stripes, guided_filter


def frame():
    y, x = np.mgrid[:64, :80] / 80
    return 0.3 + 0.3 * x + 0.2 * np.sin(3 * y + 2 * x)


def test_stripes_that_go_with_the_scene_are_found():
    scene = frame()
    gain = 1 + 0.02 * np.random.default_rng(0).standard_normal(80)
    found = estimate_stripes(gain * scene, 2, 0.4, 1.0)
    sharp = (gain - 1) * scene
    assert np.corrcoef(found.ravel(), sharp.ravel())[0, 1] > 0.85
    assert (gain * scene - found - scene).std() < 0.55 * sharp.std()


def test_a_smooth_scene_without_stripes_stays():
    assert np.abs(estimate_stripes(frame(), 2, 0.4, 1.0))[:, 5:-5].max() < 1e-3


def test_what_is_linear_in_the_guide_passes():
    guide = np.random.default_rng(1).random((30, 40))
    assert np.allclose(guided_filter(guide, 3 * guide + 2, 7, 1e-12, axis=0), 3 * guide + 2)


def test_an_edge_far_above_the_ridge_is_not_blurred():
    step = np.repeat([[0.0] * 20 + [1.0] * 20], 10, axis=0)
    assert np.abs(guided_filter(step, step, 7, 1e-4, axis=1) - step).max() < 1e-3
    assert np.abs(guided_filter(step, step, 7, 1e4, axis=1) - step).max() > 0.3
