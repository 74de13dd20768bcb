"""Torn frames, and text that a camera draws over its pictures."""

import numpy as np
import pytest

from deepir.io.inspection.checks import torn_frames, torn_message
from deepir.io.inspection.samples import drawn_message, drawn_pixels
from deepir.simulate import Settings, simulate
from deepir.simulate.scenes.procedural import procedural, sky


@pytest.fixture(scope="module")
def frames():
    return simulate(None, Settings(n_frames=6, shape=(96, 128), counts=True), seed=2).frames


@pytest.mark.parametrize("row", [8, 40, 88])
def test_a_frame_that_ends_as_the_next_one_is_torn(frames, row):
    torn = frames.copy()
    torn[3, row:] = torn[4, row:]
    assert torn_frames(torn) == {3: row}
    assert "3 (at row" in torn_message(torn_frames(torn), 6)[0]
    assert "data.frames=[0, 1, 2, 4, 5]" in torn_message(torn_frames(torn), 6)[0]


def test_a_frame_that_begins_as_the_one_before_is_torn(frames):
    torn = frames.copy()
    torn[3, :40] = torn[2, :40]
    assert torn_frames(torn) == {3: 40}


@pytest.mark.parametrize("picture", [procedural, sky])
@pytest.mark.parametrize("seed", range(4))
def test_whole_frames_are_whole(picture, seed):
    whole = simulate(picture(seed, (200, 250)), Settings(n_frames=6, shape=(64, 80), counts=True), seed=seed).frames
    assert torn_frames(whole) == {}
    assert drawn_message(drawn_pixels(whole)) == []


def test_rows_that_stand_still_in_all_frames_are_not_torn(frames):
    still = frames.copy()
    still[:, 60:] = still[0, 60:]
    assert torn_frames(still) == {}


def test_blocks_that_a_codec_leaves_as_they_were_are_not_torn(frames):
    film, rng = frames.copy(), np.random.default_rng(0)
    for k in range(1, len(film)):
        left = np.kron(rng.random((12, 16)) < 0.8, np.ones((8, 8), bool))
        left[80:] |= k == 3
        film[k][left] = film[k - 1][left]
    assert torn_frames(film) == {}


def test_text_is_found_and_single_dead_pixels_are_none(frames):
    text = frames.copy()
    text[:, 10:14, 20:40:2] = 16383
    text[:, 10, 20:40] = 16383
    text[:, 50, 60] = 0
    found = drawn_pixels(text)
    assert found[10, 20:40].all()
    assert not found[50, 60]
    assert "between rows 10 and" in drawn_message(found)[0]


def test_frames_that_are_alike_show_nothing_drawn(frames):
    assert not drawn_pixels(frames[[0, 0, 0]]).any()
