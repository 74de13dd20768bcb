"""The frames of a recording that its correction is estimated from, chosen while it is read once.

Keyframes come in groups whose frames show the same things displaced. The spacing within a group follows the motion. Of
a long recording every second group is dropped whenever there are too many: memory is bounded, and the groups stay
evenly spread.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice
from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]

GROUP_SIZE = 4  # frames of a group
MAX_GROUPS = 32  # groups that are kept, at most
#: Frames over which the motion is measured.
WINDOW = 65
#: Change of the scene within the spacing of a group, relative to that over the window.
CHANGE_WITHIN_SPACING = 0.35
#: Change since the last group, relative to that over the window, below which the camera stands and no group begins.
LEAST_CHANGE = 0.25
SPACINGS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32)  # frames
SHORT_SIDE = 48  # px, shorter side of the averaged frames whose changes are measured
HELD_OUT_EVERY = 6  # groups, of which one is held out
#: Frames of a short recording, which is kept whole.
SHORT = GROUP_SIZE * MAX_GROUPS


@dataclass(frozen=True)
class Keyframes:
    """Chosen frames.

    Attributes:
        frames: (N, h, w), float32.
        numbers: of the frames in the recording, (N,), increasing.
        groups: of each frame the number of its group, (N,).
        spacings: frames to the next that shows the same things well displaced, of each, (N,).
        length: frames of the recording.
        eight_bits: the frames have 8 bits, as after an automatic gain control.
    """

    frames: Array
    numbers: Array
    groups: Array
    spacings: Array
    length: int
    eight_bits: bool

    def split(self) -> tuple[Keyframes, Keyframes]:
        """The keyframes to estimate from, and those of some groups that are held out to judge the estimate."""
        held = self.groups % HELD_OUT_EVERY == HELD_OUT_EVERY // 2
        return self.some(~held), self.some(held)

    def some(self, chosen: Array) -> Keyframes:
        """The keyframes with these numbers, or where this is True, (N,)."""
        parts = ("frames", "numbers", "groups", "spacings")
        return replace(self, **{name: getattr(self, name)[chosen] for name in parts})

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """Keyframes that show the same things displaced, by one spacing first, then by more."""
        found = []
        for times in range(1, GROUP_SIZE):
            for i, (number, spacing) in enumerate(zip(self.numbers, self.spacings, strict=True)):
                j = int(np.abs(self.numbers - number - times * spacing).argmin())
                if j > i and abs(self.numbers[j] - number - times * spacing) <= spacing / 2:
                    found.append((i, j))
        return found or [(k, k + 1) for k in range(len(self.numbers) - 1)]


def choose_keyframes(recording: Iterable[Array]) -> Keyframes:
    """Read a recording once and keep groups of frames, spread over it; all that differ of a short one.

    Args:
        recording: frames (h, w), of any number type; read one after the other.
    """
    stream = _distinct(iter(recording))
    head = list(islice(stream, SHORT + 1))
    shown = [frame for frame in head if frame is not None]
    spacing, typical = motion_spacing(np.stack([coarse(frame) for frame in shown[:WINDOW]]))
    if len(head) <= SHORT:
        kept = [(number, frame, spacing) for number, frame in enumerate(head) if frame is not None]
        groups = np.arange(len(kept)) // GROUP_SIZE
        return _keyframes(kept, groups, len(head))
    return _chosen(chain(head, stream), [coarse(frame) for frame in shown[:WINDOW]], spacing, typical)


def _chosen(frames: Iterable[Array | None], recent: list[Array], spacing: int, typical: float) -> Keyframes:
    """Groups of frames of a long recording.

    Args:
        frames: Of the recording; None in place of one that repeats the frame before it.
        recent: The first of them, averaged.
        spacing: Of the first group, see `motion_spacing`.
        typical: Change over the window, same place.
    """
    groups: list[list[tuple[int, Array, int]]] = []
    every, opened, opening, last, number = 1, 0, -WINDOW, None, -1
    for number, frame in enumerate(frames):
        if frame is None:
            continue
        small = coarse(frame)
        if number >= WINDOW:
            recent = [*recent[1:], small]
        if groups and len(groups[-1]) < GROUP_SIZE:
            if number - groups[-1][-1][0] >= spacing:
                groups[-1].append((number, frame, spacing))
            continue
        stands = last is not None and float(np.abs(last - small).mean()) < LEAST_CHANGE * typical
        if stands or number - opening < GROUP_SIZE * spacing:
            continue
        if number >= WINDOW:
            spacing, typical = motion_spacing(np.stack(recent))
        last, opening = small, number
        if opened % every == 0:
            groups.append([(number, frame, spacing)])
        opened += 1
        if len(groups) > MAX_GROUPS:
            groups, every = groups[::2], 2 * every
    places = np.repeat(np.arange(len(groups)), [len(group) for group in groups])
    return _keyframes([each for group in groups for each in group], places, number + 1)


def _keyframes(kept: list[tuple[int, Array, int]], groups: Array, length: int) -> Keyframes:
    return Keyframes(
        frames=np.stack([np.ma.filled(frame.astype(np.float32), np.nan) for _, frame, _ in kept]),
        numbers=np.array([number for number, _, _ in kept]),
        groups=groups,
        spacings=np.array([spacing for _, _, spacing in kept]),
        length=length,
        eight_bits=kept[0][1].dtype.itemsize == 1,
    )


def coarse(frame: Array) -> Array:
    """Means of a frame (h, w) over blocks, its level taken off."""
    factor = max(1, min(frame.shape) // SHORT_SIDE)
    height, width = (side // factor for side in frame.shape)
    blocks = np.asarray(frame[: height * factor, : width * factor], np.float32)
    means = np.nan_to_num(blocks.reshape(height, factor, width, factor).mean((1, 3)))
    return np.asarray(means - np.median(means))


def motion_spacing(recent: Array) -> tuple[int, float]:
    """Spacing, frames, over which the scene changes by half of what it does over all; and the latter, in its units.

    Args:
        recent: averaged frames (N, h, w), in order. The fixed pattern cancels in their differences.
    """
    changes = {
        gap: float(np.abs(recent[gap:] - recent[:-gap]).mean()) for gap in SPACINGS if gap < len(recent)
    }
    if not changes:
        return 1, 0.0
    least, most = changes[min(changes)], max(changes.values())
    noise = min(least, float(np.median(np.abs(recent[1:] - recent[:-1]))))
    enough = noise + CHANGE_WITHIN_SPACING * (most - noise)
    return next(gap for gap, change in changes.items() if change >= enough), most


def _distinct(recording: Iterator[Array]) -> Iterator[Array | None]:
    """The frames; None in place of one that repeats the frame before it."""
    before: Array | None = None
    for frame in recording:
        repeats = before is not None and np.array_equal(frame, before)
        before = frame
        yield None if repeats else frame


def spread(pairs: Sequence[tuple[int, int]], most: int) -> list[tuple[int, int]]:
    """At most so many of the pairs, evenly spread."""
    return [pairs[i] for i in np.unique(np.linspace(0, len(pairs) - 1, min(most, len(pairs))).astype(int))]
