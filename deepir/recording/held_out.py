"""Keyframes that were held out, and what corrections leave in them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from deepir.multiview.held_out_pattern import Judge, Left
from deepir.recording.keyframes import Keyframes, spread

Array = np.ndarray[Any, Any]

MAX_PAIRS = 8


class HeldOutFrames:
    """Compares corrections `frame = level + offset + gain (scene - level)` on frames that none was estimated from.

    Args:
        held: Keyframes.
        usable: (N, h, w) bool, which of their samples count.
        level: In their units.
        corrections: (gain, offset), (h, w), by which the displacements of the scene are sought.
    """

    def __init__(
        self, held: Keyframes, usable: Array, level: float, corrections: Sequence[tuple[Array, Array]]
    ) -> None:
        self.level = level
        pairs = spread(held.pairs, MAX_PAIRS)
        frames = np.where(usable, held.frames, np.float32(level))
        self._judge = (
            Judge(frames, usable, pairs, [self._maps(*each) for each in corrections]) if pairs else None
        )

    def left(self, gain: Array, offset: Array) -> Left | None:
        """What a correction leaves; None where the frames do not tell."""
        return None if self._judge is None else self._judge.left(*self._maps(gain, offset))

    def nats(self, gain: Array, offset: Array) -> float:
        """Minus the logarithm of the frames' likelihood, but for a constant; NaN where they do not tell."""
        left = self.left(gain, offset)
        return np.nan if left is None else left.nats + float(np.nan_to_num(left.detail_nats))

    def _maps(self, gain: Array, offset: Array) -> tuple[Array, Array]:
        """The judge divides by the gain about zero, the estimate about the level."""
        return gain, offset + self.level * (1 - gain)
