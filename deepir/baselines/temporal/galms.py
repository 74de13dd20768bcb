"""What a pixel says should be like what its neighbours say, once the scene has moved."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field
from scipy import ndimage

from deepir.baselines.average import Array, correct_and_average, fill_invalid
from deepir.baselines.online import INPUT_LIMITS, frame_sequence, gain_and_offset, normalise
from deepir.burst import Burst
from deepir.config import Config
from deepir.registry import register
from deepir.result import Result

#: M of the step size; the step is half the rate at a local deviation of a tenth of the range.
EDGE_SENSITIVITY = 10.0


@register("method", "galms")
def galms(
    burst: Burst,
    config: Config,
    *,
    rate: Annotated[float, Field(gt=0, lt=1)] = 0.2,
    radius: Annotated[float, Field(gt=0)] = 3.0,
    gate: Annotated[float, Field(ge=0)] = 0.01,
    passes: Annotated[int, Field(ge=1)] = 10,
) -> Result:
    """Least mean squares towards a smoothed frame, in small steps at edges, and only where the scene has changed.

    R. C. Hardie, F. Baxley, B. Brys, P. Hytla: Scene-based nonuniformity correction with reduced ghosting using a
    gated LMS algorithm, Optics Express 17 (2009). The target is the corrected frame smoothed by a Gaussian of `radius`
    px; the step is `rate / (1 + M^2 v)` with the local variance v (Vera and Torres 2005); a pixel learns only when its
    target has changed by `gate` of the range since it last did. A burst is played `passes` times, forth and back.
    """
    frames, low, span = normalise(fill_invalid(burst.frames, burst.valid & ~burst.bad_pixels))
    weight, bias = learn_correction(frames, rate, radius, gate, passes)
    return correct_and_average(burst, config, *gain_and_offset(weight, bias, low, span))


def learn_correction(
    frames: Array, rate: float, radius: float, gate: float, passes: int = 1
) -> tuple[Array, Array]:
    """Weight and bias (h, w) that correct frames (N, h, w) from about zero to about one."""
    frames = frames.clip(*INPUT_LIMITS)
    weight, bias = np.ones(frames.shape[1:]), np.zeros(frames.shape[1:])
    last = np.full(frames.shape[1:], np.inf)
    for frame in (frames[k] for k in frame_sequence(len(frames), passes)):
        now = weight * frame + bias
        wanted = ndimage.gaussian_filter(now, radius)
        variance = ndimage.gaussian_filter(frame**2, radius) - ndimage.gaussian_filter(frame, radius) ** 2
        learns = np.abs(wanted - last) > gate
        last = np.where(learns, wanted, last)
        step = learns * rate / (1 + EDGE_SENSITIVITY**2 * variance.clip(min=0))
        error = wanted - now
        weight += step * error * frame
        bias += step * error
    return weight, bias
