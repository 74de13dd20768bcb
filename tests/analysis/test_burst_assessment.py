"""How well a burst separates a pattern from the scene."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from deepir.analysis import assess_burst, map_statistics
from deepir.analysis.burst_assessment import report_lines

SIZE = (120, 160)


@pytest.fixture(scope="module")
def pattern():
    """Alike over 6 px along both axes."""
    noise = np.random.default_rng(0).standard_normal(SIZE)
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
