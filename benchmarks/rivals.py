"""Methods that correct a recording as it comes, with their defaults: maps (gain, offset) after each frame."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from skimage.registration import phase_cross_correlation

from deepir.baselines.gradients import offsets_over_time
from deepir.baselines.least_mean_squares import (
    INPUT_LIMITS,
    corrections_over_time,
    gain_and_offset,
    galms,
    irlms,
    updated,
)
from deepir.baselines.pixel_statistics import equalised, running_statistics
from deepir.baselines.rival import normalise

Array = np.ndarray[Any, Any]
Maps = tuple[Array | float, Array]

SUBPIXEL = 10  # parts of a pixel that interframe displacements are found to


def galms_over_time(frames: Array) -> Iterator[Maps]:
    scaled, low, span = normalise(frames)
    rate, radius, gate = (_default(galms, name) for name in ("rate", "radius", "gate"))
    for learned in corrections_over_time(scaled, range(len(frames)), rate, radius, gate):
        yield gain_and_offset(*learned, low, span)


def irlms_over_time(frames: Array) -> Iterator[Maps]:
    """Displacements are those of the frames corrected so far, by phase correlation, as in the paper."""
    scaled, low, span = normalise(frames)
    scaled, rate = scaled.clip(*INPUT_LIMITS), _default(irlms, "rate")
    weight, bias = np.ones(scaled.shape[1:]), np.zeros(scaled.shape[1:])
    for before, now in zip(scaled[[0, *range(len(scaled) - 1)]], scaled, strict=True):
        shown = [weight * each + bias for each in (now, before)]
        shift, *_ = phase_cross_correlation(*shown, upsample_factor=SUBPIXEL)
        step = np.eye(3)
        step[:2, 2] = -shift[::-1]
        weight, bias = updated(weight, bias, before, now, step, rate)
        yield gain_and_offset(weight, bias, low, span)


def constant_statistics_over_time(frames: Array) -> Iterator[Maps]:
    for mean, deviation in running_statistics(frames):
        yield equalised(mean, deviation)


def multiview_tv_over_time(frames: Array) -> Iterator[Maps]:
    return ((1.0, offset) for offset in offsets_over_time(frames))


OVER_TIME: dict[str, Callable[[Array], Iterator[Maps]]] = {
    "galms": galms_over_time,
    "irlms": irlms_over_time,
    "constant_statistics": constant_statistics_over_time,
    "multiview_tv_recursive": multiview_tv_over_time,
}


def _default(method: Callable[..., Any], name: str) -> Any:
    return inspect.signature(method).parameters[name].default
