"""How close a scene is to the truth."""

import numpy as np
import pytest

from deepir.metrics import scores


def test_the_radiometric_error_forgives_a_level_and_not_a_gain():
    truth = np.random.default_rng(0).normal(8000, 100, (40, 48))
    assert scores(truth + 50, truth)["radiometric_rmse"] == pytest.approx(0, abs=1e-9)
    assert scores(1.1 * truth, truth)["radiometric_rmse"] == pytest.approx(0.1 * truth.std())
    assert scores(1.1 * truth + 50, truth)["psnr_aligned"] > 150


def test_scenes_of_many_frames_have_one_gauge():
    truth = np.random.default_rng(0).normal(8000, 100, (3, 40, 48))
    assert scores(1.1 * truth + 50, truth)["psnr_aligned"] > 150
    levels = np.array([5.0, 50, 100])[:, None, None]
    assert scores(truth + levels, truth)["psnr_aligned"] < 30
    each = [scores(truth[k] + levels[k], truth[k])["ssim"] for k in range(3)]
    assert each[0] > each[2]
