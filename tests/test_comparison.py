"""How close a scene is to the truth, and a result to its burst's."""

import dataclasses

import numpy as np
import pytest
from small_problems import whole

import deepir
from deepir.burst import load
from deepir.config import Data
from deepir.io.radiometry import Linear
from deepir.metrics import motion_error, pattern, roughness, scores
from deepir.result import compare_to_truth, neutral
from deepir.simulate import Settings, simulate

SMALL = Settings(shape=(40, 48), n_frames=4, counts=True, max_shift=4.0, dead_pixels=0.0, stray=1.0, factor=2)


@pytest.fixture
def burst(tmp_path):
    path, truth = simulate(settings=SMALL).save(tmp_path / "burst.npz")
    return load(Data(path=str(path), truth=str(truth), frames=3))


@pytest.fixture
def exact(burst):
    """The truth as a result."""
    truth = burst.truth
    scene = truth["scene"] + np.random.default_rng(0).normal(0, 1e-2, truth["scene"].shape)
    result = neutral(scene, 3, burst.size, burst.bad_pixels)
    result.gain, result.offset, result.motion = (truth[name].copy() for name in ("gain", "offset", "motion"))
    result.extra = {"stray": truth["stray"]}
    result.motion[:, :2, 2] *= SMALL.factor  # px of the scene
    return result


def test_the_truth_is_right_in_every_respect(exact, burst):
    assert burst.truth["motion"].shape == (3, 3, 3)  # of the first frames
    assert burst.truth["level"].shape == (3,)
    found = compare_to_truth(exact, burst)
    assert found["psnr"] > 90
    errors = {name: value for name, value in found.items() if name.endswith("rmse") or "residual" in name}
    assert {"gain_rmse", "offset_rmse", "stray_rmse", "motion_rmse", "radiometric_rmse"} < set(errors)
    assert max(errors.values()) < 2e-2


@pytest.mark.parametrize(("name", "off"), [("gain", 0.01), ("offset", 3.0)])
def test_an_error_in_one_column_counts_by_its_share_of_the_pixels(exact, burst, name, off):
    getattr(exact, name)[:, -1] += off
    assert compare_to_truth(exact, burst)[f"{name}_rmse"] == pytest.approx(off / burst.size[1] ** 0.5, rel=1e-3)


def test_a_motion_is_judged_in_px_of_a_frame(exact, burst):
    exact.motion[1:, 0, 2] += 1.0
    assert compare_to_truth(exact, burst)["motion_rmse"] == pytest.approx(1 / SMALL.factor, rel=1e-3)


def test_where_counts_are_kelvin_the_error_is_in_mk(exact, burst):
    exact.scene = exact.scene + np.float32(5) * (np.indices(exact.scene.shape).sum(0) % 2)
    found = compare_to_truth(exact, dataclasses.replace(burst, radiometry=Linear(0.01)))
    assert found["radiometric_rmse_mk"] == pytest.approx(25, rel=0.02)  # ± 2.5 counts of 10 mK


def test_without_a_truth_there_is_roughness_only():
    frames = simulate(settings=dataclasses.replace(SMALL, stray=0.0, factor=1)).frames
    metrics = deepir.run("nuc", frames=frames, method="average").metrics
    assert metrics["roughness"] > 0
    assert not {"psnr", "gain_rmse", "motion_rmse"} & metrics.keys()
    blank = whole(frames)
    assert compare_to_truth(neutral(frames[0], 4, (40, 48), blank.bad_pixels), blank) == {}


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
