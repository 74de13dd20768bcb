"""What a recording shows of scene and camera, in words, with the figure that each rests upon."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from deepir.analysis.fourier_ring_correlation import THRESHOLD, RingCorrelation
from deepir.recording.estimate import SensorEstimate
from deepir.recording.parallax import PARALLAX_RATIO
from deepir.recording.thermal_lag import ThermalLag


def physics_lines(
    estimate: SensorEstimate, lag: ThermalLag | None, halves: RingCorrelation | None
) -> Iterator[str]:
    """Lines on parallax, thermal lag, and how well two halves of the recording agree.

    Args:
        estimate: of the sensor.
        lag: of the pixels; None where it was not judged.
        halves: agreement of the offsets of two halves; None where they have too few frames.
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
            f"thermal lag: about {lag.frames:.1g} of the time between two frames, likelier than none by {lag.nats:.0f} "
            "nats. Motion blurs by it; it is not corrected, as that would raise the noise"
        )
    else:
        yield f"thermal lag: none is seen ({lag.frames:.1g} of the time between two frames, {lag.nats:.1f} nats)"
    if halves is None:
        yield "halves: not compared, they have too few frames"
    else:
        yield (
            f"halves: the fine offsets of odd and even groups of frames agree down to {halves.resolution:.1f} px "
            f"(Fourier ring correlation above {THRESHOLD:.2f}); 2 px is all"
        )
