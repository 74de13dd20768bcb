"""How close a scene is to the truth."""

import numpy as np
import pytest

from deepir.metrics import scores


def test_the_radiometric_error_forgives_a_level_and_not_a_gain():
    truth = np.random.default_rng(0).normal(8000, 100, (40, 48))
    assert scores(truth + 50, truth)["radiometric_rmse"] == pytest.approx(0, abs=1e-9)
    assert scores(1.1 * truth, truth)["radiometric_rmse"] == pytest.approx(0.1 * truth.std())
    assert scores(1.1 * truth + 50, truth)["psnr_aligned"] > 150
