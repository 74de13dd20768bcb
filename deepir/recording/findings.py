"""Lines on parallax, thermal lag and repeatability, each with the figure that it rests on."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from deepir.analysis.fourier_ring_correlation import RingCorrelation
from deepir.recording.estimate import SensorEstimate
from deepir.recording.parallax import PARALLAX_RATIO
from deepir.recording.thermal_lag import ThermalLag


def findings_lines(
    estimate: SensorEstimate, lag: ThermalLag | None, halves: RingCorrelation | None
) -> Iterator[str]:
    """Lines on parallax, thermal lag and repeatability of the offset.

    Args:
        estimate: of the sensor.
        lag: of the pixels; None if it was not estimated.
        halves: Fourier ring correlation of the offsets of two halves; None if they have too few frames.
    """
    ratio = estimate.parallax
    if np.isnan(ratio):
        yield "parallax: not judged, the scene's displacements are too small"
    elif ratio > PARALLAX_RATIO:
        yield (
            f"parallax: yes, a homography leaves {ratio:.2f} times the change of brightness of a dense displacement"
        )
    else:
        yield (
            "parallax: none, a homography describes the displacements "
            f"(it leaves {ratio:.2f} times the change of brightness of a dense one)"
        )
    if lag is None:
        yield "thermal lag: not judged, too little of the scene is seen at several speeds"
    elif lag.is_seen:
        yield (
            f"thermal lag: about {lag.time_constant:.1g} of the time between two frames, log-likelihood gain over none "
            f"{lag.nats:.0f} nats. It blurs motion; it is not corrected, as that would raise the noise"
        )
    else:
        yield f"thermal lag: none is seen ({lag.time_constant:.1g} of the time between two frames, {lag.nats:.1f} nats)"
    if halves is None:
        yield "repeatability: not judged, too few frames for two halves"
    else:
        yield (
            "repeatability: offsets of odd and even groups of frames agree down to a period of "
            f"{halves.resolution:.1f} px (the limit is 2 px)"
        )
