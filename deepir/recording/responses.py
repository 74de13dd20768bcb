"""Gain and offset of each pixel from registered frames.

Where another frame shows the same point of the scene, corrected, it predicts what a pixel should show. Over many pairs
of frames the residual's mean is an error of the offset, and its slope over the scene an error of the gain.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from deepir.arrays.statistics import MAD_TO_SIGMA
from deepir.kernels.compile import parallel_for
from deepir.kernels.displaced_residuals import displaced_residuals
from deepir.multiview.texture_flow import Displacement

Array = np.ndarray[Any, Any]

GAIN_SIGMA = 0.03  # prior deviation of a pixel's gain from one
OFFSET_SAMPLES = 2.0  # samples that the offset found before counts as
ROUNDS = 2  # of correcting the frames that predict
DISPLACEMENT_ERROR = 1.0  # px, standard deviation of a displacement's error
MIN_DISPLACEMENT = 2.0  # px
FRAMES_OF_NOISE = 8  # frames that the noise is measured in
NOISE_FACTOR = 1.5  # scale of a residual, in sigmas of a frame's noise: the prediction has noise too


def refine_gain_offset(
    frames: Array,
    displacements: Sequence[Displacement],
    gain: Array,
    offset: Array,
    level: float,
    *,
    with_gain: bool,
) -> tuple[Array, Array]:
    """Gain and offset (h, w) that make registered frames agree.

    Args:
        frames: raw frames (N, h, w), float32; NaN where a sample does not count.
        displacements: between corrected frames averaged over blocks.
        gain: (h, w), found before.
        offset: (h, w), found before.
        level: of `frame = level + offset + gain (scene - level)`.
        with_gain: whether gains are estimated.
    """
    for _ in range(ROUNDS):
        corrected = _corrected(frames, gain, offset, level)
        noise = NOISE_FACTOR * noise_deviation(corrected)
        sums = np.zeros((5, *offset.shape))
        for each in displacements:
            _accumulate(corrected, each, noise, level, sums)
        weight = np.maximum(sums[0], np.finfo(float).tiny)
        scene, rest = sums[1] / weight, sums[3] / weight
        spread, slope = sums[2] - sums[1] * scene, sums[4] - sums[1] * rest
        samples = weight * noise**2
        gain_error = slope / (spread + 1 / GAIN_SIGMA**2) if with_gain else np.zeros_like(scene)
        offset_error = rest * samples / (samples + OFFSET_SAMPLES)
        offset = offset + gain * (offset_error - gain_error * scene)
        gain = gain * (1 + gain_error)
    return gain, offset


def _corrected(frames: Array, gain: Array, offset: Array, level: float) -> Array:
    """Frames without gain and offset, float32."""
    corrected = np.empty_like(frames)
    weight, bias = (1 / gain).astype(np.float32), (level - (level + offset) / gain).astype(np.float32)

    def rows(first: int, last: int) -> None:
        np.multiply(frames[first:last], weight, out=corrected[first:last])
        corrected[first:last] += bias

    parallel_for(rows, len(frames))
    return corrected


def noise_deviation(frames: Array) -> float:
    """Robust standard deviation of a sample's noise, from second differences of frames (N, h, w)."""
    some = frames[:: max(1, len(frames) // FRAMES_OF_NOISE)]
    mixed = some[:, 1:, 1:] - some[:, :-1, 1:] - some[:, 1:, :-1] + some[:, :-1, :-1]
    return max(MAD_TO_SIGMA * float(np.nanmedian(np.abs(mixed))) / 2, float(np.finfo(np.float32).tiny))


def _accumulate(frames: Array, displacement: Displacement, noise: float, level: float, sums: Array) -> None:
    """Add the weights, scenes, squared scenes, residuals, and residuals times scenes of a pair to `sums` (5, h, w)."""
    here, there = frames[displacement.first], frames[displacement.second]
    down, across = displacement.vectors
    factor = min(here.shape) // min(displacement.known.shape)
    parallel_for(
        displaced_residuals,
        len(here),
        here,
        there,
        down,
        across,
        displacement.known,
        factor,
        noise,
        DISPLACEMENT_ERROR,
        MIN_DISPLACEMENT,
        level,
        sums,
    )
