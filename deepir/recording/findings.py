"""Lines on motion, uncertainty and thermal lag, each with the figure that it rests on."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from deepir.recording.estimate import SensorEstimate
from deepir.recording.thermal_lag import ThermalLag


def findings_lines(estimate: SensorEstimate, lag: ThermalLag | None) -> Iterator[str]:
    """Lines on how the frames register, how sure the offset is, and thermal lag.

    Args:
        estimate: of the sensor.
        lag: of the pixels; None if it was not estimated.
    """
    if np.isfinite(estimate.motion_error):
        yield "motion: the frames register as a whole, and were solved together with their scene"
    else:
        yield "motion: near and far things move differently; the offset rests on local displacements"
    if estimate.offset_deviation is not None:
        good = ~estimate.bad_pixels
        yield (
            f"offset: standard deviation {estimate.offset[good].std():.3g}, uncertain by "
            f"{np.sqrt(np.mean(estimate.offset_deviation[good] ** 2)):.2g} (root mean square over the pixels)"
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
