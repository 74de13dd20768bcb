"""Frames are corrected as they come, better while the camera moves, and never by what it stood still before."""

import io
import itertools
import time

import numpy as np
import pytest
from knowing import Knowing

from deepir.calibration import CorrectionMaps
from deepir.cameras.camera import camera_frames
from deepir.config.schema import Raw
from deepir.live.corrector import CHECK_INTERVAL, FADE_LENGTH, MIN_QUICK_KEYFRAMES, Corrector
from deepir.live.estimation import ENDED, ProcessEstimator, SynchronousEstimator
from deepir.live.sources import stream_raw
from deepir.multiview.pattern_gradients import removes_more
from deepir.recording.estimate import FINE_OFFSET, SensorEstimate
from deepir.recording.keyframes import WINDOW, Keyframes
from deepir.recording.segments import Segment


@pytest.fixture
def corrector():
    with Corrector(estimator=SynchronousEstimator()) as made:
        yield made


@pytest.fixture
def quick_corrector(walk):
    with Corrector(estimator=Knowing(walk.gain, walk.fine + walk.slow, walk.bad)) as made:
        yield made


def chosen(frames):
    return Keyframes.of_groups([[(k, frame, 1) for k, frame in enumerate(frames)]], len(frames))


def left(frames, scenes, walk):
    """Deviation of the pattern that is left."""
    return np.std(np.mean(np.asarray(frames, np.float64) - scenes, 0)[~walk.bad])


def test_the_pattern_goes_while_the_camera_moves_and_another_is_noticed_and_learned_anew(walk, corrector):
    corrected = [corrector(frame) for frame in walk.frames]
    assert all(frame.dtype == np.float32 for frame in corrected)
    assert np.array_equal(corrected[0], walk.frames[0])
    assert corrector.status.estimates >= 2
    assert corrector.status.correcting
    assert left(corrected[-20:], walk.scenes[-20:], walk) < 0.3 * left(walk.frames[-20:], walk.scenes[-20:], walk)
    other = np.random.default_rng(3).permutation(walk.fine.ravel()).reshape(walk.fine.shape)
    back_and_forth = [*range(119, -1, -1), *range(60)]
    changed = (walk.frames - walk.fine + other)[back_and_forth]
    corrected, fitted = [], []
    for frame in changed:
        corrected.append(corrector(frame))
        fitted.append(corrector.status.fits)
    noticed = fitted.index(False)
    assert noticed < 3 * CHECK_INTERVAL
    assert np.array_equal(corrected[noticed], changed[noticed].astype(np.float32))
    assert corrector.status.correcting
    scenes = walk.scenes[back_and_forth][-20:]
    assert left(corrected[-20:], scenes, walk) < 0.5 * left(changed[-20:], scenes, walk)


def test_nothing_is_learned_while_the_camera_stands_still(walk, corrector):
    rng = np.random.default_rng(0)
    still = walk.frames[0] + 3 * rng.standard_normal((300, *walk.gain.shape))
    for frame in still.astype(np.float32):
        assert corrector(frame) is not None
    assert corrector.status.estimates == 0
    assert corrector.maps is None
    assert "stands still" in corrector.status.message


def test_maps_of_an_earlier_day_are_taken_at_once_if_they_fit(walk):
    maps = CorrectionMaps(walk.gain, walk.fine + walk.slow + 8000 * (1 - walk.gain), walk.bad)
    wrong = 300 * np.random.default_rng(1).standard_normal(walk.gain.shape)
    frame = walk.frames[0]
    for given, expected in ((maps, maps.correct(frame)), (CorrectionMaps(np.ones_like(wrong), wrong, walk.bad), frame)):
        with Corrector(given, estimator=SynchronousEstimator()) as corrector:
            assert np.array_equal(corrector(frame), expected)
            assert corrector.status.correcting == (given is maps)


def test_new_maps_fade_in(walk):
    good, fair = (
        SensorEstimate(walk.gain, part * (walk.fine + walk.slow), walk.bad, 8000.0, None, "gain", {})
        for part in (1.0, 0.6)
    )
    estimator, frame = SynchronousEstimator(), walk.frames[0]
    with Corrector(estimator=estimator) as corrector:
        shown = []
        for estimate in (fair, good):
            estimator._found = Segment(0, 10, estimate)
            shown += [corrector(frame) for _ in range(FADE_LENGTH + 1)]
    before, after = shown[FADE_LENGTH], shown[-1]
    steps = [np.abs(later - earlier).max() for earlier, later in itertools.pairwise(shown[FADE_LENGTH:])]
    assert np.array_equal(after, Segment(0, 10, good).correct(frame))
    assert max(steps) < 1.1 * np.abs(after - before).max() / FADE_LENGTH


def test_the_first_estimate_with_shading_is_taken_though_its_fine_part_is_no_better(walk):
    error = 0.5 * walk.fine.std() * np.random.default_rng(0).standard_normal(walk.fine.shape)
    quick, whole, wrong = (
        Segment(0, 10, SensorEstimate(np.ones_like(walk.gain), offset, walk.bad, 8000.0, None, kept, 0.0))
        for offset, kept in ((walk.fine, FINE_OFFSET), (walk.fine + walk.slow + error, "offset"), (error, "offset"))
    )
    estimator, frame = SynchronousEstimator(), walk.frames[0]
    assert not removes_more(quick.correct(frame), whole.correct(frame), walk.bad)
    with Corrector(estimator=estimator) as corrector:
        for estimator._found in (quick, wrong, whole, wrong):
            corrector(frame)
    assert (corrector.status.estimates, corrector.status.rejected) == (2, 2)


def test_reset_forgets_what_was_learned(walk, quick_corrector):
    for frame in walk.frames[: WINDOW + 10]:
        quick_corrector(frame)
    assert quick_corrector.status.estimates > 0
    quick_corrector.reset()
    assert quick_corrector.status == Corrector(estimator=SynchronousEstimator()).status


def test_an_estimate_from_before_a_reset_is_dropped(walk):
    class Late(SynchronousEstimator):
        """Is done only after the reset."""

        done = False

        def busy(self):
            return not self.done

        def poll(self):
            return super().poll() if self.done else None

    estimator = Late()
    with Corrector(estimator=estimator) as corrector:
        corner = walk.frames[:, :64, :80]
        estimator.submit(chosen(corner), quick=True, former=None)
        corrector.reset()
        estimator.done = True
        corrector(corner[0])
        assert corrector.maps is None


def test_nothing_is_learned_on_hold(walk, quick_corrector):
    for frame in walk.frames[:WINDOW]:
        quick_corrector(frame)
    before = quick_corrector.status
    quick_corrector.hold = True
    for frame in walk.frames[WINDOW:]:
        quick_corrector(frame)
    assert quick_corrector.status.keyframes == before.keyframes > 0
    assert quick_corrector.status.estimates == before.estimates
    assert quick_corrector.status.state == "holding"


def test_an_estimate_that_ends_on_hold_is_taken_afterwards(walk):
    maps = CorrectionMaps(walk.gain, walk.fine + walk.slow + 8000 * (1 - walk.gain), walk.bad)
    estimator = SynchronousEstimator()
    with Corrector(maps, estimator=estimator) as corrector:
        corrector.hold = True
        estimate = SensorEstimate(walk.gain, walk.fine + walk.slow, walk.bad, 8000.0, None, "gain", {})
        estimator._found = Segment(0, 10, estimate)
        corrector(walk.frames[0])
        assert corrector.status.estimates == 0
        corrector.hold = False
        corrector(walk.frames[1])
        assert corrector.status.estimates == 1


class Waiting(Knowing):
    """Gives its estimate late."""

    def poll(self):
        return None


def test_frames_do_not_wait_for_an_estimate(walk):
    with Corrector(estimator=Waiting(walk.gain, walk.fine + walk.slow, walk.bad)) as corrector:
        for frame in walk.frames[: WINDOW + 10]:
            assert np.array_equal(corrector(frame), frame)


def test_an_estimate_comes_from_a_separate_process_and_one_that_is_killed_is_replaced(walk):
    with Corrector(estimator=ProcessEstimator()) as corrector:
        corrector._estimator._process.kill()
        corrector._estimator._process.wait()
        for frame in walk.frames:
            corrector(frame)
        assert corrector.status.keyframes >= MIN_QUICK_KEYFRAMES
        until = time.monotonic() + 60
        while corrector.status.estimates == 0 and time.monotonic() < until:
            corrector(walk.frames[-1])
            time.sleep(0.05)
        assert corrector.status.estimates == 1
        assert corrector.status.message != ENDED


def test_an_estimate_that_is_cancelled_does_not_come(walk):
    estimator = ProcessEstimator()

    def wait():
        until = time.monotonic() + 60
        while estimator.busy() and time.monotonic() < until:
            time.sleep(0.05)

    try:
        wait()
        corner = walk.frames[:, :64, :80]
        estimator.submit(chosen(corner), quick=False, former=None)
        assert estimator.busy()
        estimator.cancel()
        assert estimator.poll() is None
        wait()
        assert estimator.poll() is None
        estimator.submit(chosen(corner[:MIN_QUICK_KEYFRAMES]), quick=True, former=None)
        wait()
        found = estimator.poll()
        assert found is not None
        assert found.estimate is not None
        assert found.estimate.kept == "fine offset"
    finally:
        estimator.close()


class Unplugged:
    def __init__(self, frames):
        self.frames = list(frames)

    def read(self):
        return self.frames.pop(0) if self.frames else None


def test_a_camera_that_falls_silent_is_an_error(walk, monkeypatch):
    monkeypatch.setattr("deepir.cameras.camera.FRAME_TIMEOUT", 0.05)
    frames = camera_frames(Unplugged(walk.frames[:2]))
    assert len([next(frames), next(frames)]) == 2
    with pytest.raises(Exception, match="has sent nothing for"):
        next(frames)


def test_raw_frames_come_from_a_stream(walk):
    frames = walk.frames[:3]
    stream = io.BytesIO(b"head" + frames.astype(">u2").tobytes() + b"half a frame")
    layout = Raw(width=frames.shape[2], height=frames.shape[1], endian="big", offset=4)
    assert np.array_equal(list(stream_raw(stream, layout)), frames)
