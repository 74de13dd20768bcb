"""Held-out keyframes, and the residual pattern of corrections on them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from deepir.multiview.held_out_pattern import CorrectionScorer, ResidualPattern
from deepir.recording.keyframes import Keyframes, spread

Array = np.ndarray[Any, Any]

MAX_PAIRS = 8


class HeldOutFrames:
    """Scores corrections `frame = level + offset + gain (scene - level)` on frames that none was estimated from.

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
        self._scorer = (
            CorrectionScorer(frames, usable, pairs, [self._maps(*each) for each in corrections])
            if pairs
            else None
        )

    def score(self, gain: Array, offset: Array) -> ResidualPattern | None:
        """Residual pattern of the corrected frames; None if no pair of frames has known displacements."""
        return None if self._scorer is None else self._scorer.score(*self._maps(gain, offset))

    def nats(self, gain: Array, offset: Array) -> float:
        """Negative log-likelihood of the frames, up to a constant; NaN if no pair has known displacements."""
        residual = self.score(gain, offset)
        return np.nan if residual is None else residual.nats + float(np.nan_to_num(residual.detail_nats))

    def _maps(self, gain: Array, offset: Array) -> tuple[Array, Array]:
        """Gain and offset of `frame = offset + gain scene`, from those about the level."""
        return gain, offset + self.level * (1 - gain)
