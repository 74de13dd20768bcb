"""Least mean squares: weight and bias of each pixel learn from one frame after the other."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy import ndimage

from deepir.baselines.rival import (
    Array,
    estimate_pattern,
    estimate_registered_pattern,
    fill_invalid,
    last_of,
    normalise,
    rival,
    sampling_points,
    to_indices,
)

#: Limits of the training input, in ranges of the frames; stuck pixels beyond them would diverge.
INPUT_LIMITS = (-1.0, 2.0)
EDGE_SENSITIVITY = 10.0  # M of the step size; the step is half the rate at a local deviation of a tenth of the range

Rate = Annotated[float, Field(gt=0, lt=1)]
Passes = Annotated[int, Field(ge=1)]


@rival("galms", estimate_pattern)
def galms(
    frames: Array,
    *,
    rate: Rate = 0.2,
    radius: Annotated[float, Field(gt=0)] = 3.0,
    gate: Annotated[float, Field(ge=0)] = 0.01,
    passes: Passes = 10,
) -> tuple[Array, Array]:
    """Least mean squares towards a smoothed frame, in small steps at edges, and only where the scene has changed.

    The target is the corrected frame, smoothed by a Gaussian. The step is `rate / (1 + M^2 v)` with the local variance
    v (Vera and Torres 2005). A burst is played forth and back.

    Args:
        frames: (N, h, w).
        rate: Step size in flat regions.
        radius: Standard deviation of the Gaussian, px.
        gate: Change of a pixel's target, in ranges of the frames, before it learns again.
        passes: How often the burst is played.

    Source: R. C. Hardie, F. Baxley, B. Brys, P. Hytla: Scene-based nonuniformity correction with reduced ghosting
    using a gated LMS algorithm, Optics Express 17 (2009).
    """
    scaled, low, span = normalise(frames)
    numbers = frame_sequence(len(frames), passes)
    return gain_and_offset(*last_of(corrections_over_time(scaled, numbers, rate, radius, gate)), low, span)


def corrections_over_time(
    frames: Array, numbers: Iterable[int], rate: float, radius: float, gate: float
) -> Iterator[tuple[Array, Array]]:
    """Weight and bias (h, w) after each of the normalised frames of these `numbers`; arguments as in `galms`."""
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


@rival("irlms", estimate_registered_pattern)
def irlms(
    frames: Array, valid: Array, motion: Array | None, *, rate: Rate = 0.1, passes: Passes = 30
) -> tuple[Array, Array]:
    """Least mean squares between frames that are registered, one after the other.

    Each frame takes a step of steepest descent on the squared difference to the corrected frame before it, warped by
    bilinear interpolation. The burst is played forth and back; the paper's video is played once. The registration is
    deepir's, rotations included.

    Args:
        frames: (N, h, w).
        valid: (N, h, w) bool.
        motion: (N, 3, 3), pull homographies in px about the centre; None: none.
        rate: Step size.
        passes: How often the burst is played.

    Source: C. Zuo, Q. Chen, G. Gu, X. Sui: Scene-based nonuniformity correction algorithm based on interframe
    registration, JOSA A 28 (2011).
    """
    scaled, low, span = normalise(fill_invalid(frames, valid))
    motion = np.eye(3)[None].repeat(len(frames), 0) if motion is None else motion
    return gain_and_offset(*learn_correction(scaled, motion, rate, passes), low, span)


def learn_correction(frames: Array, motion: Array, rate: float, passes: int = 1) -> tuple[Array, Array]:
    """Weight and bias (h, w) that correct frames (N, h, w) from about zero to about one, with motion as in `irlms`."""
    frames = frames.clip(*INPUT_LIMITS)
    weight, bias = np.ones(frames.shape[1:]), np.zeros(frames.shape[1:])
    for before, now in itertools.pairwise(frame_sequence(len(frames), passes)):
        step = np.linalg.inv(motion[before]) @ motion[now]
        weight, bias = updated(weight, bias, frames[before], frames[now], step, rate)
    return weight, bias


def updated(weight: Array, bias: Array, before: Array, now: Array, step: Array, rate: float) -> tuple[Array, Array]:
    """Weight and bias after a frame `now`, which the frame `before`, pulled by `step`, predicts."""
    target = warp_bilinear(weight * before + bias, step)
    error = np.nan_to_num(target - (weight * now + bias))
    return weight + rate * error * now, bias + rate * error


def warp_bilinear(frame: Array, step: Array) -> Array:
    """A frame (h, w) after a pull by a homography (3, 3), by bilinear interpolation; NaN outside the frame."""
    at = to_indices(sampling_points(step, frame.shape), frame.shape)
    return ndimage.map_coordinates(frame, at, order=1, cval=np.nan)


def frame_sequence(n_frames: int, passes: int) -> Iterator[int]:
    """Frame numbers of a burst played forth and back `passes` times.

    >>> list(frame_sequence(3, 3))
    [0, 1, 2, 1, 0, 1, 2]
    """
    yield 0
    for k in range(passes):
        yield from range(1, n_frames) if k % 2 == 0 else range(n_frames - 2, -1, -1)


def gain_and_offset(weight: Array, bias: Array, low: float, span: float) -> tuple[Array, Array]:
    """Gain and offset (h, w) of pixels that are corrected by `weight * (y - low) / span + bias`."""
    gain = 1 / weight.clip(min=1e-3)
    return gain, low - gain * (low + span * bias)
