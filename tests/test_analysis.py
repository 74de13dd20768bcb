"""Statistics of patterns that are known, and how well a burst separates a pattern from the scene."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from deepir.analysis import assess_burst, correlation_length, flat_statistics, map_statistics, report_lines
from deepir.simulate import Settings, simulate

SIZE = (160, 192)


def blurred(sigma, seed=0):
    """White noise under a Gaussian: its autocorrelation is exp(-lag^2 / 4 sigma^2)."""
    noise = np.random.default_rng(seed).standard_normal(SIZE)
    found = ndimage.gaussian_filter(noise, sigma, mode="wrap")
    return found / found.std()


@pytest.mark.parametrize("sigma", [(1.0, 1.0), (2.0, 2.0), (1.0, 3.0), (2.5, 0.5)])
def test_correlation_lengths_are_found_within_a_pixel(sigma):
    y, x = (2 * each * np.sqrt(np.log(10)) for each in sigma)
    found = map_statistics(blurred(sigma))
    assert found.lengths == pytest.approx((x, y), abs=1)


@pytest.mark.parametrize("decay", [0.3, 0.6, 0.8])
def test_lengths_of_columns_are_those_along_x(decay):
    # A pattern of columns, each like the one before it.
    rng, columns = np.random.default_rng(1), [0.0]
    for _ in range(5 * SIZE[1]):
        columns.append(decay * columns[-1] + rng.standard_normal())
    found = map_statistics(np.tile(columns[-4 * SIZE[1] :], (120, 1)))
    assert found.columns > 0.9
    assert found.lengths[0] == pytest.approx(np.log(0.1) / np.log(decay), abs=1)


def test_white_noise_asks_for_a_pixel_and_is_no_lines():
    found = map_statistics(np.random.default_rng(2).standard_normal(SIZE))
    assert max(found.lengths) <= 1
    assert max(found.rows, found.columns, found.shading) < 0.02


def test_the_shares_of_lines_and_shading_are_found():
    rng = np.random.default_rng(3)
    y, x = np.meshgrid(*(np.linspace(-1, 1, side) for side in SIZE), indexing="ij")
    parts = {
        "rows": rng.standard_normal((SIZE[0], 1)) + 0 * x,
        "columns": 1.5 * rng.standard_normal((1, SIZE[1])) + 0 * x,
        "shading": 2 * (x + y * y),
    }
    pattern = sum(parts.values()) + rng.standard_normal(SIZE)
    found = map_statistics(pattern)
    for name, part in parts.items():
        assert getattr(found, name) == pytest.approx(part.var() / pattern.var(), abs=0.08)


def test_bad_pixels_do_not_count():
    pattern, good = blurred(2.0), np.ones(SIZE, bool)
    good[10:20, 30:60] = False
    spoilt = np.where(good, pattern, 1e4)
    assert map_statistics(spoilt, good).lengths == pytest.approx(map_statistics(pattern).lengths, abs=0.5)


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_noise_of_a_flat_stack_makes_the_pattern_no_shorter(noise):
    rng = np.random.default_rng(4)
    frames = blurred(1.5) + noise * rng.standard_normal((8, *SIZE))
    assert flat_statistics(frames).lengths == pytest.approx((4.55, 4.55), abs=0.7)


@pytest.mark.parametrize("decay", [0.9, 0.97, 0.99])
def test_for_how_long_a_drifting_pattern_holds_is_found(decay):
    rng, frames = np.random.default_rng(5), [np.random.default_rng(6).standard_normal((60, 80))]
    for _ in range(60):
        frames.append(decay * frames[-1] + np.sqrt(1 - decay**2) * rng.standard_normal((60, 80)))
    noisy = np.array(frames) + 0.5 * rng.standard_normal((61, 60, 80))
    assert flat_statistics(noisy).stable_frames == pytest.approx(np.log(0.8) / np.log(decay), rel=0.15)


def test_a_pattern_that_stays_holds_for_ever():
    frames = blurred(1.0) + 0.3 * np.random.default_rng(7).standard_normal((20, *SIZE))
    assert flat_statistics(frames).stable_frames == np.inf


def test_the_simulators_camera_has_lines_and_pixels():
    settings = Settings(n_frames=1, shading=0.0, dead_pixels=0.0, gain_pixel=0.0, gain_column=0.0)
    truth = simulate(None, settings, seed=0).truth
    found = map_statistics(truth.offset)
    total = 0.027**2 + 0.04**2 + 0.027**2
    assert found.columns == pytest.approx(0.04**2 / total, abs=0.1)
    assert found.rows == pytest.approx(0.027**2 / total, abs=0.1)


def test_a_length_lies_between_lags():
    assert correlation_length(np.array([1.0, 0.2, 0.0])) == 1.5
    assert correlation_length(np.ones(5)) == np.inf


@pytest.fixture(scope="module")
def pattern():
    """Alike over 6 px along both axes."""
    noise = np.random.default_rng(0).standard_normal((120, 160))
    return map_statistics(ndimage.gaussian_filter(noise, 2.0, mode="wrap"))


def motion(shifts):
    found = np.tile(np.eye(3), (len(shifts), 1, 1))
    found[:, :2, 2] = shifts
    return found


def test_super_resolution_needs_all_sub_pixel_phases(pattern):
    far = np.array([(0, 0), (12, 3), (-8, 12), (5, -12), (-12, -8), (9, 9)])
    whole = assess_burst(pattern, motion(far), factor=2)
    assert "show 1.0 of the 4 sub-pixel phases of super-resolution by 2" in whole.flags[-1]
    halves = np.array([(0, 0), (0.5, 0), (0, 0.5), (0.5, 0.5), (0, 0), (0.1, 0.6)])
    assert assess_burst(pattern, motion(far + halves), factor=2).flags == []


def test_far_enough_in_both_directions_suffices(pattern):
    assessment = assess_burst(pattern, motion([(0, 0), (12, 3), (-8, 12), (5, -12), (-12, -8)]))
    assert assessment.flags == []
    assert report_lines(pattern, assessment)[-1] == "this burst suffices"


@pytest.mark.parametrize(
    ("shifts", "flag"),
    [
        (
            [(0, 0), (12, 0), (-8, 0.2), (24, 0), (-20, 0)],
            "moves along x only (0.2 px along y): the pattern of the rows cannot be separated from the scene",
        ),
        (
            [(0, 0), (0, 9), (0.3, -8), (0, 12), (0, 24)],
            "moves along y only (0.3 px along x): the pattern of the columns cannot be",
        ),
        ([(0, 0), (3, 8), (-1, -9), (2, 20), (1, -20)], "moves by 4.0 px along x: 7 px are wanted"),
        ([(0, 0), (10, 10), (20, 20), (-10, -10)], "moves along one line, slanted, and 0.0 px across it"),
        ([(0, 0), (15, 15)], "too few frames: 2; take 5 or more"),
        ([(0, 0), (8, 1), (1, 8), (0, 1), (1, 0)], "independent looks at the pattern"),
    ],
)
def test_what_a_burst_lacks_is_said(pattern, shifts, flag):
    assessment = assess_burst(pattern, motion(shifts))
    assert any(flag in each for each in assessment.flags), assessment.flags
    assert "this burst suffices" not in report_lines(pattern, assessment)


def test_what_the_average_keeps_is_what_an_average_of_shifted_patterns_keeps(pattern):
    # Equation for the variance of the estimate, against the thing itself.
    shifts = np.array([(0, 0), (2, 1), (-3, 4), (5, 5), (1, -2)])
    averaged = np.mean([np.roll(pattern.pattern, shift[::-1], (0, 1)) for shift in shifts], axis=0)
    left = assess_burst(pattern, motion(shifts)).residual_share
    assert left == pytest.approx(averaged.std() / pattern.pattern.std(), rel=0.05)


def test_a_rotation_moves_what_is_off_the_centre(pattern):
    turned = np.tile(np.eye(3), (3, 1, 1))
    for k, angle in enumerate((0.0, 0.1, -0.1)):
        turned[k, :2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    moves = assess_burst(pattern, turned).displacements
    assert np.abs(moves[4]).max() == 0
    assert np.abs(moves[0]).max() > 3


def test_words_say_how_far_and_how_many(pattern):
    lines = report_lines(pattern)
    assert "pixels 9" in lines[0]
    assert "more than 7 px in x and 6 px in y" in lines[1]
    assert any("with --flat" in line for line in lines)
    assert any("take 5 to 20 frames" in line for line in lines)


def test_a_pattern_correlated_over_all_lags_is_said_not_to_be_separable(pattern):
    endless = replace(pattern, lengths=(math.inf, 5.0))
    far = assess_burst(endless, motion([(0, 0), (12, 3), (-8, 12), (5, -12), (-12, -8)]))
    assert far.flags == ["no finite motion along x separates the pattern from the scene"]
    lines = report_lines(endless, far)
    assert "no jitter separates it from the scene" in lines[1]
    assert not any("move the camera" in line or "any number" in line for line in lines)
