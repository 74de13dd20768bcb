"""Correct frames as they come: `corrected = corrector(frame)`."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from deepir.arrays import Array
from deepir.arrays.samples import as_float32
from deepir.calibration import CorrectionMaps
from deepir.live.estimation import ENDED, ProcessEstimator, SynchronousEstimator
from deepir.live.recorder import LiveKeyframes
from deepir.multiview.pattern_gradients import contains_pattern, removes_more
from deepir.recording.segments import Segment

MIN_QUICK_KEYFRAMES = 16  # before a quick estimate, of the fine offset, where frames are not corrected
MIN_KEYFRAMES = 48  # before an estimate of all: the low-order part needs more
GROWTH = 1.5  # of the number of keyframes, from one estimate to the next ...
MAX_NEW_KEYFRAMES = 32  # ... but no more than these
CHECK_INTERVAL = 8  # frames between two checks whether the maps fit
FADE_LENGTH = 15  # frames over which new maps take the place of former ones, so that the picture does not jump
CHECKS = 3  # newest checks, whose majority decides whether the maps fit


@dataclass(frozen=True)
class Status:
    """How far a corrector is.

    Attributes:
        frames: Seen so far.
        keyframes: Chosen so far; none while the camera stands still.
        estimates: Of the sensor that were taken.
        rejected: Estimates that would have left more pattern in newer frames.
        correcting: Whether frames are corrected now.
        fits: False where the last frames do not have the maps' pattern, so that they pass as they are.
        holding: Whether the corrector learns nothing further.
        estimating: Whether an estimate is under way.
        message: Why the last estimate was not possible; empty if it was.
    """

    frames: int = 0
    keyframes: int = 0
    estimates: int = 0
    rejected: int = 0
    correcting: bool = False
    fits: bool = True
    holding: bool = False
    estimating: bool = False
    message: str = ""

    @property
    def state(self) -> str:
        """What it does, in a few words."""
        if not self.fits:
            return "uncorrected: the maps do not fit"
        if self.holding:
            return "holding"
        if self.correcting:
            return "correcting"
        return "learning" if self.keyframes > 1 else "waiting for motion"  # the first frame is one

    def __str__(self) -> str:
        line = f"{self.state}, {self.estimates} estimate(s), {self.keyframes} keyframes"
        return line + (f" ({self.message})" if self.message else "")


class Corrector:
    """Corrects frames (h, w) of one camera with the newest estimate of its sensor; a context manager.

    Keyframes are chosen while the camera moves, and none while it stands still, so that no scene is taken for the
    pattern. The first estimate is a quick one, of the fine offset. An estimate is taken if a frame that it has not seen
    has most of the pattern. Frames that have not, as after a closure of the shutter, pass uncorrected.

    Args:
        maps: Of the same camera, to begin with.
        estimator: What estimates the sensor; a process of its own unless given.

    Attributes:
        hold: True: nothing further is learned; no keyframes are chosen and no estimates are taken.
    """

    def __init__(
        self, maps: CorrectionMaps | None = None, *, estimator: SynchronousEstimator | ProcessEstimator | None = None
    ) -> None:
        self._estimator = estimator or ProcessEstimator()
        self.begin(maps)

    def __enter__(self) -> Corrector:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def begin(self, maps: CorrectionMaps | None) -> None:
        """Forget all, and begin with other maps."""
        self._start = maps
        self.reset()

    def reset(self) -> None:
        """Forget all but the maps of the beginning, and learn anew."""
        self.hold = False
        self._estimator.cancel()
        self._keyframes = LiveKeyframes()
        self._segment: Segment | None = None
        self._former: Segment | None = None
        self._faded = 0  # frames since the newest estimate
        self._checks: deque[bool] = deque(maxlen=CHECKS)  # whether the maps fitted the last frames
        self._relearns = False  # another pattern than the maps'
        self._is_first = True  # of a pattern: an estimate that takes little time
        self._due = 0
        self._frames = self._estimates = self._rejected = 0
        self._message = ""

    def close(self) -> None:
        """End what estimates."""
        self._estimator.close()

    def __call__(self, frame: Array) -> Array:
        """The corrected frame (h, w), float32, in the frame's units."""
        if not self.hold:
            self._learn(frame)
        corrected = self._correct(frame)
        if self._frames % CHECK_INTERVAL == 0 and corrected is not None:
            self._check(frame, corrected)
        self._frames += 1
        self._faded += 1
        return as_float32(frame) if corrected is None or not self._fits else corrected

    @property
    def maps(self) -> CorrectionMaps | None:
        """Those that frames are corrected with; None as long as there are none."""
        return self._segment.maps if self._segment else self._start

    @property
    def _fits(self) -> bool:
        """Whether the maps fit, as most of the last checks say."""
        return 2 * sum(self._checks) >= len(self._checks)

    @property
    def _bad_pixels(self) -> Array:
        assert self.maps is not None
        return self.maps.bad_pixels

    @property
    def status(self) -> Status:
        """How far it is."""
        return Status(
            self._frames,
            self._keyframes.taken,
            self._estimates,
            self._rejected,
            self.maps is not None and self._fits,
            self._fits,
            self.hold,
            self._estimator.busy(),
            self._message,
        )

    def _learn(self, frame: Array) -> None:
        """Take an estimate that is done, consider the frame as a keyframe, and begin an estimate if it is time."""
        if (found := self._estimator.poll()) is not None:
            self._take(found, frame)
        self._keyframes.add(frame)
        taken = self._keyframes.taken
        former = self.maps if self._fits else None
        quick = former is None and (self._is_first or self._keyframes.count < MIN_KEYFRAMES)
        enough = taken >= self._due and self._keyframes.count >= (MIN_QUICK_KEYFRAMES if quick else MIN_KEYFRAMES)
        if enough and not self._estimator.busy():
            self._estimator.submit(self._keyframes.chosen(), quick=quick, former=former)
            self._is_first = False
            growth = round((GROWTH - 1) * self._keyframes.count)
            self._due = taken + (MIN_QUICK_KEYFRAMES if quick else min(MAX_NEW_KEYFRAMES, growth))

    def _check(self, frame: Array, corrected: Array) -> None:
        """Check whether the maps fit a frame; where they no longer do, the pattern is another: learn it anew."""
        self._checks.append(contains_pattern(as_float32(frame), corrected, self._bad_pixels))
        if not self._fits and not self._relearns and not self.hold:
            self._relearns = self._is_first = True
            self._keyframes.forget(self._keyframes.length - CHECK_INTERVAL)  # two checks have failed since
            self._estimator.cancel()
            self._due = self._keyframes.taken

    def _take(self, found: Segment, frame: Array) -> None:
        """Take an estimate if it serves the newest frame."""
        self._message = found.refused
        if found.estimate is None:
            if found.refused != ENDED:  # the camera stood still: begin again
                self._keyframes.forget(found.last + 1)
            self._due = self._keyframes.taken + MIN_QUICK_KEYFRAMES
            return
        self._keyframes.forget(found.first)  # another pattern
        if not self._serves(found, as_float32(frame)):
            self._rejected += 1
            self._due = max(self._due, self._keyframes.taken + MIN_QUICK_KEYFRAMES)
            return
        self._former, self._faded = self._segment if self._fits else None, 0
        self._segment = found
        self._checks.extend([True] * CHECKS)
        self._relearns = False
        self._estimates += 1

    def _serves(self, found: Segment, frame: Array) -> bool:
        """Whether an estimate leaves less pattern in a frame than there is now, or is the first with shading."""
        corrected = found.correct(frame)
        now = self._correct(frame) if self._fits else None
        fine = [bool(each and each.estimate and each.estimate.is_fine) for each in (self._segment, found)]
        if now is None or fine == [True, False]:  # gradients, by which two are compared, hardly show shading
            return contains_pattern(frame, corrected, found.maps.bad_pixels)
        return removes_more(now, corrected, found.maps.bad_pixels | self._bad_pixels)

    def _correct(self, frame: Array) -> Array | None:
        """The frame corrected by the newest maps, faded in from the former ones; None as long as there are none."""
        if self._segment is None:
            return None if self._start is None else self._start.correct(frame)
        corrected = self._segment.correct(frame)
        if self._former is not None and self._faded < FADE_LENGTH:
            former = self._former.correct(frame)
            corrected = former + np.float32(self._faded / FADE_LENGTH) * (corrected - former)
        return corrected
