"""How much fixed pattern a correction leaves, judged by frames of a moving scene.

The scene moves, the pattern stays. Along the displacement of the scene between two frames the brightness of corrected
frames does not change; what a pattern leaves does. This needs no truth, and frames that the correction was not
estimated from.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage

from deepir.closed_form.slow_pattern import averaged
from deepir.closed_form.unregistered import median_pattern
from deepir.registration.texture_flow import RADIUS, Displacement, displacements, sampled

Array = np.ndarray[Any, Any]

#: Share of the frame that has to be known to have moved.
LEAST_KNOWN = 0.02
#: Shorter side, px, to which frames are averaged at least.
SHORT_SIDE = 80
#: Samples that say the same, for the displacement of all in a window is one.
CORRELATED = (2 * RADIUS + 1) ** 2
DETAIL = 5  # px, of the box average that is taken off for the pattern's detail


@dataclass(frozen=True)
class Left:
    """What a correction leaves along the displacements of the scene.

    `change` is the root mean square change of brightness, robust, in the frames' units; `nats` minus the logarithm of
    its likelihood, but for a constant that all corrections share.
    """

    change: float
    nats: float


class Judge:
    """Compares corrections (gain, offset), (h, w), on frames (N, h, w).

    Args:
        frames: of one sensor.
        usable: which samples count, same shape.
        pairs: of frames that show the same things displaced.
        corrections: those that are to be compared; the displacements are found on frames corrected by each, and on
            frames without the detail that all share, so that none is favoured.
    """

    def __init__(
        self,
        frames: Array,
        usable: Array,
        pairs: Sequence[tuple[int, int]],
        corrections: Sequence[tuple[Array, Array]],
    ) -> None:
        self.usable, self.factor = usable, max(1, min(frames.shape[1:]) // SHORT_SIDE)
        self.frames = frames
        #: What all frames share, (h, w), as their median gradients have it.
        self.shared = median_pattern(frames, usable)
        detail = self.shared - ndimage.uniform_filter(self.shared, DETAIL)
        #: Displacements that tell, found in each of these ways.
        self.found: list[Displacement] = []
        ways = [self.coarse(*each) for each in ((np.ones_like(detail), detail), *corrections)]
        for way in ways:
            self.found += [each for each in displacements(way, pairs) if each.share_moved >= LEAST_KNOWN]
        #: Scale of the change along each, by the best of these ways; all corrections are compared by it.
        self.scales = [
            max(min(_spread(_change(way, each)) for way in ways), np.finfo(float).tiny) for each in self.found
        ]

    def coarse(self, gain: Array, offset: Array) -> Array:
        """The corrected frames, averaged over blocks."""
        corrected = (self.frames - offset) / gain
        return np.stack([averaged(*each, self.factor) for each in zip(corrected, self.usable, strict=True)])

    def left(self, gain: Array, offset: Array) -> Left | None:
        """What a correction leaves; None where the frames do not tell."""
        if not self.found:
            return None
        frames, nats, spreads = self.coarse(gain, offset), 0.0, []
        for found, scale in zip(self.found, self.scales, strict=True):
            change = _change(frames, found)
            nats += float(np.log1p((change / scale) ** 2).sum()) / CORRELATED
            spreads.append(_spread(change))
        return Left(float(np.mean(spreads)) / 2**0.5, nats)


def _change(frames: Array, found: Displacement) -> Array:
    """Changes of brightness along a displacement, where it is known, less that of the level."""
    change = (frames[found.first] - sampled(frames[found.second], found.y, found.x))[found.known]
    return np.asarray(change - np.median(change))


def _spread(change: Array) -> float:
    """Robust standard deviation about zero."""
    return 1.4826 * float(np.median(np.abs(change)))
