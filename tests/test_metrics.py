"""How close a scene is to the truth."""

import numpy as np
import pytest

from deepir.metrics import motion_error, pattern, roughness, scores


def test_scores_forgive_a_level_and_a_gain_but_not_the_radiometric_error_a_gain():
    truth = np.random.default_rng(0).normal(8000, 100, (40, 48))
    assert scores(truth + 50, truth)["radiometric_rmse"] == pytest.approx(0, abs=1e-9)
    assert scores(1.1 * truth, truth)["radiometric_rmse"] == pytest.approx(0.1 * truth.std())
    found = scores(1.1 * truth + 50, truth)
    assert found["psnr_aligned"] > 150
    assert found["residual_columns"] == pytest.approx(0, abs=1e-8)
    assert found["residual_pixels"] == pytest.approx(0, abs=1e-8)
    negative = scores(-truth, truth)["psnr_aligned"]  # no better than the mean
    assert negative == pytest.approx(20 * np.log10(np.ptp(truth) / truth.std()))


def test_scenes_of_many_frames_have_one_gauge():
    truth = np.random.default_rng(0).normal(8000, 100, (3, 40, 48))
    assert scores(1.1 * truth + 50, truth)["psnr_aligned"] > 150
    levels = np.array([5.0, 50, 100])[:, None, None]
    assert scores(truth + levels, truth)["psnr_aligned"] < 30
    each = [scores(truth[k] + levels[k], truth[k])["ssim"] for k in range(3)]
    assert each[0] > each[2]


def test_columns_and_pixels_are_separated_and_nothing_smooth_counts():
    rng = np.random.default_rng(0)
    columns, pixels = np.tile(rng.normal(0, 3, 400), (300, 1)), rng.normal(0, 2, (300, 400))
    rows, smooth = rng.normal(0, 5, (300, 1)), np.linspace(0, 50, 400)
    assert pattern(columns + rows + smooth) == pytest.approx((3, 0), rel=0.1, abs=1e-9)
    assert pattern(pixels + rows + smooth) == pytest.approx((2 / 300**0.5, 2), rel=0.1)


def test_roughness_is_what_neighbours_differ_by_to_the_level():
    board = np.indices((40, 48)).sum(0) % 2
    assert roughness(np.full((40, 48), 7.0)) == 0
    assert roughness(100.0 + board) == pytest.approx((39 * 48 + 40 * 47) / (100.5 * 40 * 48))


def test_a_motion_is_as_far_off_as_a_frames_corners():
    still, moved, turned = (np.tile(np.eye(3), (3, 1, 1)) for _ in range(3))
    moved[2, :2, 2] = 3, 4
    assert motion_error(moved, still, (40, 48)) == pytest.approx(5 / 2**0.5)
    angle = 0.01
    turned[1:, :2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    assert motion_error(turned, still, (40, 48)) == pytest.approx(angle * np.hypot(19.5, 23.5), rel=1e-3)
    assert motion_error(moved[:2], still[:2], (40, 48)) == 0
    assert np.isnan(motion_error(np.full((2, 3, 3), np.nan), still[:2], (40, 48)))
