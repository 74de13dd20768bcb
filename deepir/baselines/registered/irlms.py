"""Least mean squares between registered frames."""

from __future__ import annotations

import itertools
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy import ndimage

from deepir.baselines.average import (
    Array,
    correct_and_average,
    fill_invalid,
    register_burst,
    sampling_points,
    to_indices,
)
from deepir.baselines.online import INPUT_LIMITS, frame_sequence, gain_and_offset, normalise
from deepir.burst import Burst
from deepir.config import Config
from deepir.registry import register
from deepir.result import Result


@register("method", "irlms")
def irlms(
    burst: Burst,
    config: Config,
    *,
    rate: Annotated[float, Field(gt=0, lt=1)] = 0.1,
    passes: Annotated[int, Field(ge=1)] = 30,
) -> Result:
    """Least mean squares between frames that are registered, one after the other.

    Each frame takes a step of steepest descent on the squared difference to the corrected frame before it, warped by
    bilinear interpolation. The burst is played forth and back; the paper's video is played once. The registration is
    deepir's, rotations included.

    Args:
        burst: The burst to correct.
        config: Its configuration.
        rate: Step size.
        passes: How often the burst is played.

    Source: C. Zuo, Q. Chen, G. Gu, X. Sui: Scene-based nonuniformity correction algorithm based on interframe
    registration, JOSA A 28 (2011).
    """
    found = motion, used, _ = register_burst(burst, config)
    frames, low, span = normalise(fill_invalid(burst.frames, burst.valid & ~burst.bad_pixels)[used])
    steps = np.eye(3)[None].repeat(len(frames), 0) if motion is None else motion[used].numpy()
    weight, bias = learn_correction(frames, steps, rate, passes)
    return correct_and_average(burst, config, *gain_and_offset(weight, bias, low, span), found)


def learn_correction(frames: Array, motion: Array, rate: float, passes: int = 1) -> tuple[Array, Array]:
    """Weight and bias that correct normalised frames; arguments as in `irlms`.

    Args:
        frames: (N, h, w), from about zero to about one.
        motion: (N, 3, 3), pull homographies in px about the centre.

    Returns:
        Weight and bias, (h, w).
    """
    frames = frames.clip(*INPUT_LIMITS)
    weight, bias = np.ones(frames.shape[1:]), np.zeros(frames.shape[1:])
    for before, now in itertools.pairwise(frame_sequence(len(frames), passes)):
        step = np.linalg.inv(motion[before]) @ motion[now]
        weight, bias = updated(weight, bias, frames[before], frames[now], step, rate)
    return weight, bias


def updated(
    weight: Array, bias: Array, before: Array, now: Array, step: Array, rate: float
) -> tuple[Array, Array]:
    """Weight and bias after a frame `now`, which the frame `before`, pulled by `step`, predicts."""
    target = warp_bilinear(weight * before + bias, step)
    error = np.nan_to_num(target - (weight * now + bias))
    return weight + rate * error * now, bias + rate * error


def warp_bilinear(frame: Array, step: Array) -> Array:
    """A frame (h, w) after a pull by a homography (3, 3), by bilinear interpolation; NaN outside the frame."""
    at = to_indices(sampling_points(step, frame.shape), frame.shape)
    return ndimage.map_coordinates(frame, at, order=1, cval=np.nan)
