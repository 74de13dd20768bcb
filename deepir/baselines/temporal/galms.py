"""Gated least mean squares towards a smoothed frame."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy import ndimage

from deepir.baselines.average import Array, correct_and_average, fill_invalid
from deepir.baselines.online import INPUT_LIMITS, frame_sequence, gain_and_offset, last_of, normalise
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

    The target is the corrected frame, smoothed by a Gaussian. The step is `rate / (1 + M^2 v)` with the local variance
    v (Vera and Torres 2005). A burst is played forth and back.

    Args:
        burst: The burst to correct.
        config: Its configuration.
        rate: Step size in flat regions.
        radius: Standard deviation of the Gaussian, px.
        gate: Change of a pixel's target, in ranges of the frames, before it learns again.
        passes: How often the burst is played.

    Source: R. C. Hardie, F. Baxley, B. Brys, P. Hytla: Scene-based nonuniformity correction with reduced ghosting
    using a gated LMS algorithm, Optics Express 17 (2009).
    """
    frames, low, span = normalise(fill_invalid(burst.frames, burst.valid & ~burst.bad_pixels))
    weight, bias = learn_correction(frames, rate, radius, gate, passes)
    return correct_and_average(burst, config, *gain_and_offset(weight, bias, low, span))


def learn_correction(
    frames: Array, rate: float, radius: float, gate: float, passes: int = 1
) -> tuple[Array, Array]:
    """Weight and bias that correct normalised frames; arguments as in `galms`.

    Args:
        frames: (N, h, w), from about zero to about one.

    Returns:
        Weight and bias, (h, w).
    """
    return last_of(corrections_over_time(frames, frame_sequence(len(frames), passes), rate, radius, gate))


def corrections_over_time(
    frames: Array, numbers: Iterable[int], rate: float, radius: float, gate: float
) -> Iterator[tuple[Array, Array]]:
    """Weight and bias after each of the frames of these `numbers`, as in `learn_correction`."""
    weight, bias = np.ones(frames.shape[1:]), np.zeros(frames.shape[1:])
    last = np.full(frames.shape[1:], np.inf)
    for frame in (frames[k].clip(*INPUT_LIMITS) for k in numbers):
        corrected = weight * frame + bias
        target = ndimage.gaussian_filter(corrected, radius)
        variance = ndimage.gaussian_filter(frame**2, radius) - ndimage.gaussian_filter(frame, radius) ** 2
        learns = np.abs(target - last) > gate
        last = np.where(learns, target, last)
        step = learns * rate / (1 + EDGE_SENSITIVITY**2 * variance.clip(min=0))
        error = target - corrected
        weight = weight + step * error * frame
        bias = bias + step * error
        yield weight, bias
