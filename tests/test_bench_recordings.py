"""The yardstick of recordings: its scores are what they are said to be, and its tables count what is worse."""

import importlib

import numpy as np
import pytest
from scipy import ndimage

pytestmark = pytest.mark.usefixtures("benchmarks")
SHAPE = (64, 80)
SLOPE = np.linspace(-1, 1, SHAPE[0])[:, None] * np.ones(SHAPE)


@pytest.fixture
def scores(benchmarks):
    return importlib.import_module("recordings_scores")


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def test_a_slope_is_low_order_and_pixels_are_fine(rng, scores):
    pixels = rng.normal(size=SHAPE)
    pattern = 10 * SLOPE + pixels
    assert scores.left_over(pattern, pattern) == pytest.approx({"low": 1, "fine": 1})
    without_slope = scores.left_over(pixels, pattern)
    assert without_slope["low"] < 0.02
    assert without_slope["fine"] == pytest.approx(1, abs=0.05)  # a slope bends at the border
    twice = scores.left_over(20 * SLOPE, pattern)
    assert twice["low"] == pytest.approx(2, rel=0.02)


def test_unknown_pixels_do_not_count(rng, scores):
    pattern = rng.normal(size=SHAPE)
    error = 0.5 * pattern
    error[10:14, 20] = np.nan
    assert scores.left_over(error, pattern)["fine"] == pytest.approx(0.5, rel=0.01)


def test_the_level_of_a_frame_is_free_and_its_gain_is_known(rng, scores):
    scene, gains = rng.normal(size=(5, *SHAPE)), np.array([1.0, 2.0, 3.0, 1.0, 1.0])
    levels = rng.normal(size=(5, 1, 1))
    corrected = scene + gains[:, None, None] * SLOPE + levels
    np.testing.assert_allclose(scores.mean_error(corrected, scene, gains), SLOPE, atol=1e-12)


def test_true_deviations_cover_what_they_promise(rng, scores):
    deviation = rng.uniform(1, 3, (200, 200))
    found = scores.covered(deviation * rng.normal(size=deviation.shape), deviation)
    assert found == pytest.approx({"covers 68": 0.683, "covers 95": 0.95}, abs=0.01)
    assert scores.covered(deviation, None) == {}


def test_bad_pixels_are_found_or_false(scores):
    true, found = np.zeros((2, 10, 10), bool)
    true[0, :4] = found[0, 2:5] = True
    assert scores.bad_pixels(found, true) == pytest.approx({"bad": 0.03, "bad, false": 0.01, "bad, found": 0.5})
    assert "bad, found" not in scores.bad_pixels(found, np.zeros_like(true))


def test_edges_of_a_scene_are_uneven_and_pixels_are_not(rng, scores):
    pattern = rng.normal(size=(256, 256)) + rng.normal(size=256) + rng.normal(size=(256, 1))
    assert scores.unevenness(pattern) == pytest.approx(1.06, abs=0.05)
    pattern[:128, :128] *= 6
    assert scores.unevenness(pattern) > 3


def test_held_out_frames_ask_for_the_pattern_that_is_there(rng, scores):
    scene, pattern = 60 * ndimage.gaussian_filter(rng.normal(size=(96, 160)), 2), rng.normal(size=(96, 120))
    frames = np.stack([scene[:, 2 * k : 2 * k + 120] + pattern for k in range(8)]).astype(np.float32)
    right, wrong = (scores.held_out(frames, (1.0, sign * pattern)) for sign in (1, -1))
    assert right["held-out fine"] < 0.5
    assert right["held-out nats"] > 0
    assert wrong["held-out fine"] > 1.5
    assert wrong["held-out nats"] < 0


def test_more_noise_or_less_motion_raise_the_limit():
    from recordings_limit import information

    rng = np.random.default_rng(1)
    shifts, turns = rng.uniform(-12, 12, (20, 2)), np.zeros(20)

    def limit(times, few):
        found = information(shifts * times, turns, (48, 64))[:, :]
        return np.trace(np.linalg.inv(found / few + np.eye(len(found))))

    assert limit(1, 1) < limit(1, 4)
    assert limit(1, 1) < limit(0.2, 1)
    at_rest = information(0 * shifts, turns, (48, 64))
    assert np.abs(at_rest).max() < 1e-6 * len(shifts) * 16


@pytest.fixture
def rows():
    run = {"family": "drive", "name": "a", "seed": 0, "method": "correct", "status": "done", "kept": ""}
    figures = run | {"fine": 0.5, "raw likeness": 0.9, "seconds": 2.0, "CPU seconds": 1.0}
    return [
        figures | {"low": 0.5, "likeness": 0.99},
        figures | {"low": 1.5, "likeness": 0.80, "name": "b"},
        figures | {"low": 0.1, "likeness": 0.95, "name": "c", "bad, false": 0.01},
        run | {"name": "d", "status": "refused: no"},
        figures | {"low": 0.4, "likeness": 0.5, "method": "mean"},
    ]


def test_a_table_counts_what_is_refused_and_what_is_worse_and_a_line_says_how_it_ended(rows):
    from recordings_tables import line, summary

    text = "\n".join(summary(rows))
    assert "## Drive: 4 recordings, seeds 0" in text
    assert (
        "| correct | 1 | 1, 0, 1 of 3 | 0.500 (1.50) |  | 0.500 (0.50) | 0.950 (0.80) | 0.900 | 1.000 (1.00) |" in text
    )
    assert "Best low: `mean` (0.400); ahead of `correct`: `mean`. Best fine: `correct` (0.500). Best likeness" in text
    assert line(rows[3]) == "drive 0: d: correct: refused: no"
    assert "fine 0.5, low 0.5, likeness 0.99, raw likeness 0.9; 2.00 s, CPU 1.00 s" in line(rows[0])


def test_every_family_has_recordings_or_a_reason():
    from bench_recordings import FAMILIES

    for family, module in FAMILIES.items():
        if not module.missing(family):
            assert module.names(family, 0), family
