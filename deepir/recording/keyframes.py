"""The frames of a recording that its correction is estimated from, chosen while it is read once.

Keyframes come in groups whose frames show the same things displaced. The spacing within a group follows the motion. Of
a long recording every second group is dropped whenever there are too many: memory is bounded, and the groups stay
evenly spread.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice
from typing import Any, TypeVar

import numpy as np

from deepir.arrays import Array
from deepir.arrays.samples import as_float32
from deepir.io.guards import warn_once
from deepir.recording.defective_pixels import noise_deviation

T = TypeVar("T")
Chosen = tuple[int, Array, int]  # number, frame (h, w), spacing

GROUP_SIZE = 4  # frames of a group
MAX_GROUPS = 32  # groups that are kept, at most
WINDOW = 65  # frames over which the motion is measured
CHANGE_WITHIN_SPACING = 0.35  # change of the scene within the spacing of a group, relative to that over the window
#: Change since the last group, relative to that over the window, below which the camera stands and no group begins.
MIN_CHANGE_OF_GROUP = 0.25
MIN_CHANGE_OF_FRAME = 0.1  # the same since the last frame, below which the camera stands
SPACINGS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32)  # frames
SHORT_SIDE = 48  # px, shorter side of the averaged frames whose changes are measured
SHORT = GROUP_SIZE * MAX_GROUPS  # frames of a short recording, which is kept whole
#: Deviation of independent neighbours, relative to that of usual frames, and to that of all samples of the frame, above
#: which it is no picture: samples that are drawn at random have one, grass and gravel through a lens 0.1 to 0.3.
MAX_DETAIL_RATIO, MAX_INDEPENDENCE = 8.0, 0.7


@dataclass(frozen=True)
class Keyframes:
    """Chosen frames.

    Attributes:
        frames: (N, h, w), float32; of `of_groups` (h, w) each, as they came.
        numbers: of the frames in the recording, (N,), increasing.
        spacings: frames to the next that shows the same things well displaced, of each, (N,).
        length: frames of the recording.
    """

    frames: Array
    numbers: Array
    spacings: Array
    length: int

    @classmethod
    def of_groups(cls, groups: Sequence[Sequence[Chosen]], length: int) -> Keyframes:
        """Those of groups, frames not copied yet; `length`: frames of the recording."""
        parts: Any = zip(*chain.from_iterable(groups), strict=True)
        numbers, frames, spacings = parts
        return cls(frames, np.array(numbers), np.array(spacings), length)

    def copied(self) -> Keyframes:
        """With a copy of the frames, float32; NaN where a sample is masked."""
        frames = np.empty((len(self.frames), *self.frames[0].shape), np.float32)
        for copy, frame in zip(frames, self.frames, strict=True):
            copy[:] = as_float32(frame)
        return replace(self, frames=frames)

    def subset(self, selection: Array) -> Keyframes:
        """The keyframes at these indices, or where a mask (N,) is True."""
        parts = ("frames", "numbers", "spacings")
        return replace(self, **{name: getattr(self, name)[selection] for name in parts})

    def moving(self) -> Keyframes:
        """Those that show something else than the one before: without the frames in which the camera stands."""
        small = [coarse(frame) for frame in self.frames]
        _, typical = motion_spacing(np.stack(small))
        kept = [0]
        for k in range(1, len(small)):
            if np.abs(small[k] - small[kept[-1]]).mean() >= MIN_CHANGE_OF_FRAME * typical:
                kept.append(k)
        return self.subset(np.array(kept))

    @property
    def neighbours(self) -> list[list[int]]:
        """Of each keyframe those that are one to three spacings away: they show the same things displaced."""
        apart = np.abs(self.numbers - self.numbers[:, None]) / self.spacings[:, None]
        return [np.flatnonzero((row > 0.5) & (row < GROUP_SIZE - 0.5)).tolist() for row in apart]

    @property
    def stretches(self) -> list[Array]:
        """Indices of keyframes in a row that show the same things displaced: seven, at the spacing of groups."""
        cuts = [0]
        for k, number in enumerate(self.numbers):
            if number - self.numbers[cuts[-1]] > (2 * GROUP_SIZE - 1.5) * self.spacings[cuts[-1]]:
                cuts.append(k)
        return spread(np.split(np.arange(len(self.numbers)), cuts[1:]), MAX_GROUPS // 2)


def choose_keyframes(recording: Iterable[Array]) -> Keyframes:
    """Read a recording once and keep groups of frames, spread over it; all that differ of a short one.

    Args:
        recording: frames (h, w), of any number type; read one after the other.
    """
    stream = iter(recording)
    head = list(islice(stream, SHORT + 1))
    if len(head) <= SHORT:
        shown = [k for k in range(len(head)) if k == 0 or not np.array_equal(head[k], head[k - 1])]
        spacing, _ = motion_spacing(np.stack([coarse(head[k]) for k in shown[:WINDOW]]))
        kept = [(k, head[k], spacing) for k in shown]
        return _pictures(Keyframes.of_groups([kept], len(head)).copied())
    collector = KeyframeCollector()
    for frame in chain(head, stream):
        collector.add(frame)
    return _pictures(Keyframes.of_groups(collector.groups, collector.length).copied())


def _pictures(keyframes: Keyframes) -> Keyframes:
    """The keyframes without those of samples that say nothing of each other, as numbers of a calibration do not."""
    some = keyframes.frames[:, :SHORT_SIDE]  # rows enough
    detail = np.array([noise_deviation(frame[None]) for frame in some])
    spread = np.ma.masked_invalid(some).std((1, 2)).filled(np.inf)
    odd = (detail > MAX_DETAIL_RATIO * np.median(detail)) & (detail > MAX_INDEPENDENCE * spread)
    if odd.any():
        numbers = ", ".join(map(str, keyframes.numbers[odd]))
        warn_once(f"frame(s) {numbers} are no pictures like the others and are left out of the estimate")
    return keyframes.subset(~odd) if odd.any() else keyframes


class KeyframeCollector:
    """Chooses keyframes among frames that come one after the other.

    Args:
        latest: True: of too many groups the latest are kept. False: every second one, again and again.

    Attributes:
        groups: Keyframes that are kept, of more than `WINDOW` frames.
        length: Frames so far.
        taken: Keyframes chosen since the start, those that were dropped included.
    """

    def __init__(self, *, latest: bool = False) -> None:
        self.length = 0
        self._latest = latest
        self._head: list[tuple[int, Array, Array]] = []  # until the motion is measured
        self._recent: list[Array] = []  # the last frames, averaged
        self.groups: list[list[Chosen]] = []
        self._every, self._opened, self._opening = 1, 0, -WINDOW
        self._last: Array | None = None  # first frame of the last group, averaged
        self._before: Array | None = None
        self._spacing, self._typical = 1, 0.0
        self.taken = 0

    @property
    def count(self) -> int:
        """Keyframes that are kept."""
        return sum(len(group) for group in self.groups)

    def forget(self, number: int) -> None:
        """Drop the keyframes before a frame."""
        self.groups = [[each for each in group if each[0] >= number] for group in self.groups]
        self.groups = [group for group in self.groups if group]

    def add(self, frame: Array) -> Array | None:
        """Consider the next frame (h, w); returns it averaged over blocks, None if it repeats the frame before it."""
        number, repeats = self.length, self._before is not None and np.array_equal(frame, self._before)
        self.length, self._before = number + 1, frame
        if repeats:
            return None
        small = coarse(frame)
        self._recent = [*self._recent[-WINDOW + 1 :], small]
        self._head.append((number, frame, small))
        if len(self._recent) == WINDOW:
            if len(self._head) == WINDOW:
                self._spacing, self._typical = motion_spacing(np.stack(self._recent))
            for each in self._head:
                self._consider(*each)
            self._head = []
        return small

    def _consider(self, number: int, frame: Array, small: Array) -> None:
        """Add a frame to the last group, or begin one with it, if it is time."""
        if self.groups and len(self.groups[-1]) < GROUP_SIZE:
            if number - self.groups[-1][-1][0] >= self._spacing:
                self.groups[-1].append((number, frame, self._spacing))
                self.taken += 1
            return
        stands = (
            self._last is not None and float(np.abs(self._last - small).mean()) < MIN_CHANGE_OF_GROUP * self._typical
        )
        if stands or number - self._opening < GROUP_SIZE * self._spacing:
            return
        if number >= WINDOW:
            self._spacing, self._typical = motion_spacing(np.stack(self._recent))
        self._last, self._opening = small, number
        if self._opened % self._every == 0:
            self.groups.append([(number, frame, self._spacing)])
            self.taken += 1
        self._opened += 1
        if len(self.groups) > MAX_GROUPS:
            if self._latest:
                del self.groups[0]
            else:
                self.groups, self._every = self.groups[::2], 2 * self._every


def coarse(frame: Array) -> Array:
    """Means of a frame (h, w) over blocks, its level taken off."""
    factor = max(1, min(frame.shape) // SHORT_SIDE)
    height, width = (side // factor for side in frame.shape)
    rows = np.asarray(frame[: height * factor, : width * factor], np.float32).reshape(height, factor, -1).sum(1)
    means = np.nan_to_num(rows.reshape(height, width, factor).sum(2) / factor**2)
    return np.asarray(means - np.median(means))


def motion_spacing(recent: Array) -> tuple[int, float]:
    """Spacing of keyframes, from the mean change of the scene over several spacings.

    Args:
        recent: averaged frames (N, h, w), in order. The fixed pattern cancels in their differences.

    Returns:
        The spacing, frames, from which the change is `CHANGE_WITHIN_SPACING` of the largest one, above noise; and that
        largest change, frames' units.
    """
    changes = {gap: float(np.abs(recent[gap:] - recent[:-gap]).mean()) for gap in SPACINGS if gap < len(recent)}
    if not changes:
        return 1, 0.0
    least, most = changes[min(changes)], max(changes.values())
    noise = min(least, float(np.median(np.abs(recent[1:] - recent[:-1]))))
    enough = noise + CHANGE_WITHIN_SPACING * (most - noise)
    return next(gap for gap, change in changes.items() if change >= enough), most


def spread(values: Sequence[T], most: int) -> list[T]:
    """At most so many of the values, evenly spread."""
    return [values[i] for i in np.unique(np.linspace(0, len(values) - 1, min(most, len(values))).astype(int))]
