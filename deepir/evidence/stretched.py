"""Pictures that a camera or a program has stretched, each frame by its own: what tells them, and their contrasts."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepir.evidence.strengths import left, pattern_left
from deepir.problem import Problem

Array = np.ndarray[Any, Any]
MOST = 0.5  # share of a frame at the ends of the range from which these are left as they are
DEGREE = 4  # of what is slow over a frame, in which shading looks like contrast
LARGEST = 3.0  # contrast that is believed
GROSS = 0.02  # contrasts that a start tells from the pattern
ALIKE = 0.002  # contrasts that a round finds of pictures that are all of one range
UNLIKE = 0.02  # contrasts that are worth a message
EQUAL = 0.01  # of the samples: equalised frames have so many of each range of values; others are 0.13 and more off


def is_stretched(frames: Array) -> bool:
    """Whether frames (N, h, w), NaN where unknown, may have contrasts of their own: 8 bits, or all of one range.

    An automatic gain makes such pictures, and so does who scales each frame to [0, 1]. Pixels at an end in all frames
    are dead and tell nothing.
    """
    low, high = np.nanmin(frames), np.nanmax(frames)
    if low >= 0 and 1 < high <= 255 and np.array_equal(frames, np.rint(frames), equal_nan=True):
        return True
    ends = [frames == end for end in (low, high)]
    return all((end & ~end.all(0)).any((1, 2)).all() for end in ends)


def is_equalised(frames: Array) -> bool:
    """Whether the histogram of each of frames (N, h, w), NaN where unknown, is even: a sample's value is its rank."""
    for frame in frames:
        values, counts = np.unique(frame[np.isfinite(frame)], return_counts=True)
        if len(values) < 3:
            return False
        below = counts[1:].cumsum() / counts[1:].sum()
        if np.abs(below - (values[1:] - values[0]) / (values[-1] - values[0])).max() > EQUAL:
            return False
    return True


def equalised_message(frames: Array) -> list[str]:
    """Say so if frames (N, h, w), NaN where unknown, are equalised."""
    if not is_equalised(frames):
        return []
    return [
        "each frame's histogram is equalised: its values are ranks, not flux, so that neither gain and offset nor the "
        "scene's contrasts mean much. Record the raw (radiometric) stream of 14 or 16 bits, or a linear gain"
    ]


def cut_off(frames: Array) -> Array:
    """Samples of frames (N, h, w), bool, at an end of the range: cut off. Not of frames that mostly are."""
    cut = (frames == np.nanmin(frames)) | (frames == np.nanmax(frames))
    return np.asarray(cut & (cut.mean((1, 2), keepdims=True) < MOST))


@torch.no_grad()
def even_contrast(problem: Problem, least: float = 0.0) -> bool:
    """Divide the frames of stretched pictures by their contrasts, of mean one, as far as these are found by now.

    About the middle of the samples, where a contrast that is not quite found changes the levels least: these are left
    to the drift. At a start, contrasts that all differ by less than `least` are left as they are, and what stands still
    is not in the prediction yet. Once a round has shown that all are alike, nothing more is done. Whether any was
    divided.
    """
    if not problem.stretched or problem.even:
        return False
    expected = problem.predict(problem.values())
    if least:
        expected = expected + pattern_left(left(problem), problem.precision.sign())
    slopes = [_slope(*each) for each in zip(problem.data, expected, problem.precision, strict=True)]
    contrast = torch.stack(slopes).to(problem.data)[:, None, None, None]
    contrast = (contrast / contrast.mean()).clamp(1 / LARGEST, LARGEST)
    if not (contrast - 1).abs().max() > least:
        return False
    whole = contrast * problem.contrast
    if not least and (whole / whole.mean() - 1).abs().max() < ALIKE:
        contrast = 1 / problem.contrast
        problem.even.fill_(True)
    middle = problem.data[problem.precision > 0].median()
    problem.data.sub_(middle).div_(contrast).add_(middle)
    problem.contrast.mul_(contrast)
    return True


def contrast_message(problem: Problem) -> list[str]:
    """Say so if contrasts differ."""
    apart = float((problem.contrast / problem.contrast.mean() - 1).abs().max())
    if apart < UNLIKE:
        return []
    return [
        f"the contrast of the frames differs by up to {apart:.0%}, as an automatic gain makes it: it is evened out. "
        "Record with a fixed gain, 14 or 16 bits, to measure"
    ]


def _slope(frame: Tensor, expected: Tensor, weight: Tensor) -> Tensor:
    """Of a frame on what is expected of it, (1, h, w), by least squares, less what is slow."""
    y, x = (torch.linspace(-1, 1, side).to(frame).double() for side in frame.shape[1:])
    slow = [(y**i)[:, None] * x**j for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]
    design = torch.stack([expected[0].double(), *slow]).flatten(1)
    weighted = design * weight.flatten()
    normal = weighted @ design.T
    normal.diagonal().mul_(1 + 1e-9)
    return torch.linalg.solve(normal, weighted @ frame.flatten().double())[0]
