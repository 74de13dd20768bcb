"""Correct a whole recording: read it once for the sensor, and once more for the corrected frames."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from deepir.arrays import Array
from deepir.calibration import CorrectionMaps
from deepir.io import write_npz
from deepir.recording.estimate import SensorEstimate
from deepir.recording.keyframes import Keyframes, choose_keyframes
from deepir.recording.segments import Segment, estimate_segments, segment_at

FEW = 10  # frames, of fewer of which all are needed, whatever they are worth


def findings_lines(estimate: SensorEstimate) -> Iterator[str]:
    """Lines on how the frames register, and how sure the offset of an estimate is."""
    if np.isfinite(estimate.motion_error):
        yield "motion: the frames register, and were solved together with their scenes"
    else:
        yield "motion: near and far things move differently; the offset rests on local displacements"
    found, left = estimate.pattern_deviations
    if np.isfinite(left):
        yield (f"offset: standard deviation {found:.3g}, uncertain by {left:.2g} (root mean square over the pixels)")


@dataclass(frozen=True)
class CorrectedRecording:
    """A recording and the estimates of its sensor; iterating gives corrected frames (h, w), float32.

    Attributes:
        read: Reads the recorded frames from the start.
        segments: The parts of the recording with one fixed pattern each; most have one.
        keyframes: That the sensor was estimated from.
    """

    read: Callable[[], Iterator[Array]]
    segments: list[Segment]
    keyframes: Keyframes

    @classmethod
    def of(
        cls,
        read: Callable[[], Iterator[Array]],
        track: Callable[[Iterator[Array]], Iterator[Array]] = iter,
        of_few: Callable[[Array], SensorEstimate] | None = None,
    ) -> CorrectedRecording:
        """Read a recording once, and estimate its sensor.

        Args:
            read: Reads the recorded frames (h, w) from the start.
            track: Passes frames on while they are read, and shows progress.
            of_few: Estimates the sensor of fewer than `FEW` frames (N, h, w); None: they are no exception.

        Raises:
            DataError: It has few frames, or the camera stands still.
        """
        keyframes = choose_keyframes(track(read()))
        if of_few is not None and keyframes.length < FEW:
            segments = [Segment(0, keyframes.length - 1, of_few(np.stack(list(read()))))]
        else:
            segments = estimate_segments(keyframes)
        return cls(read, segments, keyframes)

    def __len__(self) -> int:
        return self.keyframes.length

    def __iter__(self) -> Iterator[Array]:
        return (self.correct(frame, number) for number, frame in enumerate(self.read()))

    @property
    def frames(self) -> Array:
        """All corrected frames, (N, h, w), float32."""
        return np.stack(list(self))

    @property
    def estimate(self) -> SensorEstimate:
        """Of the sensor, as it is at the end of the recording."""
        return next(each.estimate for each in reversed(self.segments) if each.estimate)

    @property
    def messages(self) -> tuple[str, ...]:
        """Those of all parts, each once."""
        return tuple(dict.fromkeys(each for part in self.segments if part.estimate for each in part.estimate.messages))

    @functools.cached_property
    def maps(self) -> CorrectionMaps:
        """Gain, offset and bad pixels of the same time, as `deepir apply` takes them: frame = gain scene + offset."""
        return next(each.maps for each in reversed(self.segments) if each.estimate)

    def correct(self, frame: Array, number: int | None = None) -> Array:
        """Correct a frame (h, w) of this camera, in the recording's units.

        Args:
            frame: Of the recording, or recorded after it.
            number: In the recording; None: after it.
        """
        place = len(self) if number is None else number
        return segment_at(self.segments, place, frame).correct(frame, place)

    def save_maps(self, path: str | os.PathLike[str]) -> None:
        """Write gain, offset and bad pixels, and the offset's standard deviation where it is known, to an `.npz`.

        Where the pattern jumps, `gains` and `offsets` (segments, h, w) and the number of each one's first frame follow.
        """
        parts = [each for each in self.segments if each.estimate]
        over_time = {
            "gains": np.stack([each.maps.gain for each in parts]).astype(np.float32),
            "offsets": np.stack([each.maps.offset for each in parts]).astype(np.float32),
            "first_frames": np.array([each.first for each in parts]),
        }
        deviation = self.estimate.offset_deviation
        write_npz(
            path,
            {
                "gain": self.maps.gain.astype(np.float32),
                "offset": self.maps.offset.astype(np.float32),
                "bad_pixels": self.maps.bad_pixels,
                "level": np.array(self.estimate.level),
                **({} if deviation is None else {"offset_deviation": deviation.astype(np.float32)}),
                **(over_time if len(self.segments) > 1 else {}),
            },
        )
