"""Frames are corrected one after the other, and how fast is measured."""

import time

import numpy as np
import pytest

from deepir.live.corrector import Corrector
from deepir.live.estimation import SynchronousEstimator
from deepir.live.sources import Paced, play


def test_the_rate_is_that_of_the_frames_and_drops_are_counted(frames):
    def late():
        for number, frame in enumerate(frames[:20]):
            if number == 10:
                time.sleep(0.12)
            yield frame

    *_, last = play(Paced(late(), 50.0), Corrector(estimator=SynchronousEstimator()))
    assert last.dropped >= 5
    assert last.number + last.dropped == 20
    assert 5 < last.rate < 150
    assert 0 < last.delay < 0.1
    assert np.array_equal(last.raw, frames[19])


def test_a_single_frame_has_no_rate(frames):
    (only,) = play(iter(frames[:1]), Corrector(estimator=SynchronousEstimator()))
    assert (only.number, only.rate) == (1, pytest.approx(0))
