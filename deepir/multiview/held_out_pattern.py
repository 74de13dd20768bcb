"""How much fixed pattern a correction leaves, judged by frames of a moving scene.

The scene moves, the pattern stays. Along the displacement of the scene between two frames the brightness of corrected
frames does not change; a residual low-order pattern changes it. The fine detail of two frames at the same pixel is
unrelated where the scene has moved; a residual fine pattern is the same in both. This needs no truth, and frames that
the correction was not estimated from.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from deepir.arrays import Array
from deepir.arrays.samples import MAD_TO_SIGMA, block_means
from deepir.multiview.pattern_gradients import gradient_consensus
from deepir.multiview.texture_flow import RADIUS, Displacement, displacements, sampled

MIN_KNOWN = 0.02  # share of the frame that has to be known to have moved
SHORT_SIDE = 80  # shorter side, px, to which frames are averaged at least
CORRELATED = (2 * RADIUS + 1) ** 2  # correlated samples: one displacement is estimated for all of a window
DETAIL = 5  # px, of the box average that is taken off for the pattern's detail
CORRELATED_DETAIL = 4.0  # correlated pixels of the detail
#: px by which the scene has moved where its detail is unrelated to that before, and robust deviations of the detail
#: beyond which it is an edge, and counts as these.
DETAIL_REACH, EDGE_LIMIT = 2.0, 3.0


@dataclass(frozen=True)
class ResidualPattern:
    """Residual fixed pattern of corrected frames.

    Attributes:
        change: robust root mean square change of brightness along the scene's displacements, frames' units.
        pair_nats: negative log-likelihood of these changes, of each pair of frames, up to a constant.
        detail: standard deviation of the fine pattern, frames' units; NaN where it is not judged.
        detail_nats: negative log-likelihood of the fine detail, up to a constant; NaN likewise.
    """

    change: float
    pair_nats: Array
    detail: float
    detail_nats: float

    @property
    def nats(self) -> float:
        """Negative log-likelihood of the changes of all pairs."""
        return float(self.pair_nats.sum())


class CorrectionScorer:
    """Scores corrections (gain, offset), (h, w), on frames (N, h, w).

    Args:
        frames: of one sensor.
        usable: which samples count, same shape.
        pairs: of frames that show the same things displaced.
        corrections: those that are to be compared; the displacements are found on frames corrected by each, and on
            frames without the detail that all share, so that none is favoured.
        independent: whether the corrections were estimated from other frames: else these have their noise, and do not
            judge the fine pattern.
    """

    def __init__(
        self,
        frames: Array,
        usable: Array,
        pairs: Sequence[tuple[int, int]],
        corrections: Sequence[tuple[Array, Array]],
        *,
        independent: bool = True,
    ) -> None:
        self.usable, self.factor = usable, max(1, min(frames.shape[1:]) // SHORT_SIDE)
        self.frames, self.independent = frames, independent
        #: Pattern (h, w) that the frames' gradients share.
        self.shared = gradient_consensus(frames, usable)
        detail = self.shared - ndimage.uniform_filter(self.shared, DETAIL)
        #: Displacements of moving scenes, found in each of these ways.
        self.found: list[Displacement] = []
        self.ways = [(np.ones_like(detail), detail), *corrections]
        coarse = [self.coarse(*each) for each in self.ways]
        for way in coarse:
            self.found += [each for each in displacements(way, pairs) if each.share_moved >= MIN_KNOWN]
        #: Scale of the change along each, by the best of these ways; all corrections are compared by it.
        self.scales = [
            max(min(_spread(_change(way, each)) for way in coarse), float(np.finfo(np.float32).tiny))
            for each in self.found
        ]
        self._find_detail()

    def coarse(self, gain: Array, offset: Array) -> Array:
        """The corrected frames, averaged over blocks."""
        return block_means((self.frames - offset) / gain, self.usable, self.factor)

    def score(self, gain: Array, offset: Array) -> ResidualPattern | None:
        """Residual pattern of the corrected frames; None if no pair of frames has known displacements."""
        if not self.found:
            return None
        frames, spreads = self.coarse(gain, offset), []
        nats = {(each.first, each.second): 0.0 for each in self.found}
        for found, scale in zip(self.found, self.scales, strict=True):
            change = _change(frames, found)
            nats[found.first, found.second] += float(np.log1p((change / scale) ** 2).sum()) / CORRELATED
            spreads.append(_spread(change))
        shared, count, most = 0.0, 0, EDGE_LIMIT * self.deviation
        for pair, moved in self.moved.items():
            one, other = (self._detail(gain, offset, k)[moved].clip(-most, most) for k in pair)
            shared += float((one * other).sum())
            count += int(moved.sum())
        detail = max(shared / count, 0.0) ** 0.5 if count else np.nan
        fine = shared / self.deviation**2 / CORRELATED_DETAIL / 2 if count else np.nan
        return ResidualPattern(float(np.mean(spreads)) / 2**0.5, np.array(list(nats.values())), detail, fine)

    def _find_detail(self) -> None:
        """Where the scene of each pair has moved by more than its detail reaches, and the detail's deviation."""
        self.moved: dict[tuple[int, int], Array] = {}
        height, width = self.frames.shape[1:]
        for each in self.found if self.independent else ():
            far = np.hypot(*each.vectors) * self.factor > DETAIL_REACH
            whole = np.zeros((height, width), bool)
            block = (far & each.known).repeat(self.factor, 0).repeat(self.factor, 1)
            whole[: block.shape[0], : block.shape[1]] = block
            both = self.usable[each.first] & self.usable[each.second] & whole
            # Where any way of finding it says that the scene stands still, it may.
            pair = each.first, each.second
            self.moved[pair] = self.moved.get(pair, both) & both
        deviations = [min(_spread(self._detail(*way, k)) for way in self.ways) for pair in self.moved for k in pair]
        typical = float(np.median(deviations)) if deviations else 1.0
        self.deviation = max(typical, float(np.finfo(np.float32).tiny))

    def _detail(self, gain: Array, offset: Array, k: int) -> Array:
        corrected = (self.frames[k] - offset) / gain
        return np.asarray(corrected - ndimage.uniform_filter(corrected, DETAIL))


def _change(frames: Array, found: Displacement) -> Array:
    """Changes of brightness along a displacement, where it is known, less that of the level."""
    change = (frames[found.first] - sampled(frames[found.second], found.y, found.x))[found.known]
    return np.asarray(change - np.median(change))


def _spread(change: Array) -> float:
    """Robust standard deviation about zero."""
    return MAD_TO_SIGMA * float(np.median(np.abs(change)))
