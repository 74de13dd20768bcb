"""How strong the fixed pattern is in each frame of a camera with an automatic gain control."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from deepir.arrays.samples import as_float32
from deepir.multiview.frame_gains import frame_gains, pattern_gain

Array = np.ndarray[Any, Any]

SIDES = (120, 160)  # px, of the middle of the frame that is looked at
STRIDE = 4  # keyframes, of which one is looked at first


@dataclass(frozen=True)
class PatternStrength:
    """The strength of a pattern in frames: of geometric mean one over those that the pattern was estimated from.

    Attributes:
        pattern: (h, w), of the middle of the frame.
        reference: what the pattern's gradients give for a strength of one, as an estimate has errors.
    """

    pattern: Array
    reference: float

    @classmethod
    def of_frames(cls, pattern: Array, frames: Array, usable: Array) -> PatternStrength:
        """With the mean strength over frames (N, h, w) as one."""
        raw = cls(middle(pattern), 1.0)
        found = [raw(*each) for each in zip(frames[::STRIDE], usable[::STRIDE], strict=True)]
        return cls(raw.pattern, float(np.exp(np.mean(np.log(np.maximum(found, 1e-3))))))

    def __call__(self, frame: Array, usable: Array | None = None) -> float:
        """Strength in a frame (h, w)."""
        data = as_float32(middle(frame))
        good = np.isfinite(data) if usable is None else middle(usable)
        gain, _ = pattern_gain(*(torch.from_numpy(np.array(each)) for each in (data, good, self.pattern)))
        return float(gain) / self.reference


def pattern_strengths(frames: Array, usable: Array, pattern: Array) -> Array | None:
    """Strengths (N,) of a pattern (h, w) in frames (N, h, w), of geometric mean one; None if they do not differ."""
    data, good, shared = (torch.from_numpy(np.array(middle(each))) for each in (frames, usable, pattern))
    if frame_gains(data[::STRIDE], good[::STRIDE], shared) is None:
        return None
    found = frame_gains(data, good, shared)
    return None if found is None else found.numpy().astype(np.float32)


def middle(values: Array) -> Array:
    """The middle of (..., h, w), of at most `SIDES`."""
    rows, columns = (
        slice(max(0, (side - most) // 2), (side + most) // 2)
        for side, most in zip(values.shape[-2:], SIDES, strict=True)
    )
    return values[..., rows, columns]
