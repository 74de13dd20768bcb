"""Displacements under a fixed pattern, the low-order pattern that they show, and scores of corrections."""

import driving
import numpy as np
import pytest
from driving import SIZE
from scipy import ndimage
from skimage import data

from deepir.multiview.held_out_pattern import CorrectionScorer
from deepir.multiview.low_order_pattern import low_order_pattern
from deepir.multiview.texture_flow import displacements

ONE = np.ones(SIZE)


@pytest.fixture(scope="module")
def drive():
    return driving.drive(ndimage.zoom(data.camera().astype(float), 0.7, order=1), 8)


@pytest.fixture(scope="module")
def shading():
    """A bowl and a slope, of mean zero."""
    y, x = np.mgrid[-1 : 1 : SIZE[0] * 1j, -1 : 1 : SIZE[1] * 1j]
    shading = 30 * (x**2 + y**2) + 20 * y
    return shading - shading.mean()


def test_displacements_are_those_of_the_zoom_and_do_not_follow_a_shading(drive, shading):
    (found,) = displacements(drive[[0, 2]] + shading, [(0, 1)])
    rows = np.arange(SIZE[0])[:, None] - (SIZE[0] - 1) / 2
    error = np.abs(found.y - np.arange(SIZE[0])[:, None] - rows * (1.03**2 - 1))
    assert found.known.mean() > 0.3
    assert np.median(error[found.known]) < 0.2


def test_a_moving_scene_shows_the_low_order_pattern(drive, shading):
    found = low_order_pattern(drive + shading, np.ones(drive.shape, bool))
    assert np.corrcoef(found.ravel(), shading.ravel())[0, 1] > 0.9
    assert low_order_pattern(drive, np.ones(drive.shape, bool)).std() < 0.3 * shading.std()


def test_scenes_that_have_nothing_in_common_show_none(shading):
    pictures = [data.camera(), data.coins(), data.moon(), data.brick(), data.grass(), data.gravel()]
    frames = np.stack([each[: SIZE[0], : SIZE[1]].astype(float) for each in pictures]) + shading
    assert low_order_pattern(frames, np.ones(frames.shape, bool)) is None


def judged(frames, correction, *others):
    pairs = [(k, k + 2) for k in range(6)]
    scorer = CorrectionScorer(frames, np.ones(frames.shape, bool), pairs, [correction])
    return [scorer.score(*each) for each in (correction, *others)]


def test_the_true_correction_is_likelier_than_none_and_than_one_with_a_false_slope(drive, shading):
    stripes = 10 * np.random.default_rng(0).standard_normal(SIZE[1])
    frames = drive + shading + stripes
    true, none = (ONE, shading + stripes), (ONE, 0 * ONE)
    false = (ONE, shading + stripes + np.linspace(-150, 150, SIZE[0])[:, None])
    for correction in (true, false):
        _, *left = judged(frames, correction, true, none, false)
        assert left[0].nats < left[1].nats - 100
        assert left[0].nats < left[2].nats - 100
        assert left[0].change < 0.5 * left[1].change


def test_frames_without_motion_give_no_score(shading):
    frames = np.repeat(data.camera()[None, :120, :160].astype(float), 8, 0)
    assert judged(frames, (ONE, shading)) == [None]
