"""Corrections that leave more pattern than simpler ones are given up, and frames that do not register are not."""

import driving
import numpy as np
import pytest
from driving import SIZE
from scipy import ndimage
from skimage import data

from deepir.burst import Burst
from deepir.errors import DataError
from deepir.messages import Message
from deepir.pipeline.safeguard import safeguarded, unregistered
from deepir.result import neutral
from deepir.simulate.recording import RecordingSettings, residual_pattern, simulate_recording


@pytest.fixture(scope="module")
def drive():
    """Twelve frames; the first eight are the burst, the others beside it."""
    return driving.drive(ndimage.zoom(data.brick().astype(float), 0.8, order=1), 12).astype(np.float32)


STRIPES = 8 * np.random.default_rng(0).standard_normal(SIZE[1]).astype(np.float32)


def burst(frames, *, beside=True):
    valid = np.ones((8, *SIZE), bool)
    return Burst(frames[:8], valid, np.zeros(SIZE, bool), beside=frames[8:] if beside else None)


def result(frames, offset):
    found = neutral(frames[0] - offset, 8, SIZE, np.zeros(SIZE, bool))
    found.offset = np.broadcast_to(offset, SIZE).astype(np.float32)
    return found


@pytest.mark.parametrize("beside", [True, False])
def test_a_good_correction_stays(drive, beside):
    frames = drive + STRIPES
    found = result(frames, STRIPES)
    kept = safeguarded(found, burst(frames, beside=beside), registered=True)
    assert kept is found
    assert kept.messages == []
    left = kept.metrics["fixed_pattern_left"]
    assert left["corrected"] < 0.5 * left["raw"]


@pytest.mark.parametrize("beside", [True, False])
def test_a_false_slope_is_taken_out(drive, beside):
    frames = drive + STRIPES
    slope = np.linspace(-300, 300, SIZE[0])[:, None]
    given_up = result(frames, STRIPES + slope)
    given_up.messages = [Message("still-region", "of what is given up"), Message("level-drift", "of the frames")]
    kept = safeguarded(given_up, burst(frames, beside=beside), registered=True)
    assert np.corrcoef(kept.offset.ravel(), np.broadcast_to(STRIPES, SIZE).ravel())[0, 1] > 0.8
    assert "uncorrected frames" in kept.messages[0]
    assert kept.messages[1:] == ["of the frames"]


@pytest.fixture(scope="module")
def film():
    """Of a camera that drives."""
    settings = RecordingSettings(n_frames=48, frame_rate=16, shape=(64, 80), shutter_every=60.0)
    return simulate_recording(settings, seed=1)


@pytest.mark.parametrize("beside", [True, False])
def test_a_low_order_part_without_evidence_and_registration_is_left_to_the_scenes(film, beside):
    level = film.frames.mean()
    slope = 15 * film.truth.noise * np.linspace(-1, 1, 64)[:, None]
    offset = film.truth.offset.mean(0) + (film.truth.gain - 1) * level + slope
    frames = film.frames[::6].astype(np.float32)
    others = film.frames[np.add.outer([1, 9, 17, 25, 33, 40], [0, 4]).ravel()].astype(np.float32)
    valid = np.ones(frames.shape, bool)
    data = Burst(frames, valid, film.truth.bad_pixels, beside=others if beside else None)
    found = neutral(frames - offset, 8, (64, 80), film.truth.bad_pixels)
    found.offset = offset.astype(np.float32)
    kept = safeguarded(found, data, registered=False)
    assert "without its low-order part" in kept.messages[0]
    assert residual_pattern(film.frames - kept.offset, film) < residual_pattern(film.frames, film)
    assert np.allclose(kept.scene, frames - kept.offset, atol=1)


def test_where_nothing_is_to_be_corrected_a_wrong_correction_is_given_up(drive):
    scene = drive[0] - ndimage.gaussian_filter(drive[0], 20)
    kept = safeguarded(result(drive, scene), burst(drive), registered=True)
    assert np.abs(kept.offset).max() == 0
    assert "the result has no correction" in kept.messages[0]
    assert np.array_equal(kept.scene, drive[0])


def test_frames_whose_parts_move_get_an_offset_without_registration(drive):
    refusal = DataError("they do not register")
    found = unregistered(burst(drive + STRIPES), refusal)
    assert np.corrcoef(np.diff(found.offset.mean(0)), np.diff(STRIPES))[0, 1] > 0.9
    assert found.frames_used.tolist() == [True] + 7 * [False]


def test_frames_that_stand_still_are_refused(drive):
    still = drive[:1].repeat(12, 0) + np.random.default_rng(1).standard_normal((12, *SIZE)).astype(np.float32)
    with pytest.raises(DataError, match="they do not register"):
        unregistered(burst(still), DataError("they do not register"))
