"""Integers that a writer has stored in another type or order of bytes than the file says."""

from __future__ import annotations

from typing import Any

import numpy as np

from deepir.errors import DataError

Array = np.ndarray[Any, np.dtype[Any]]

SAMPLED_FRAMES = 4  # frames that are inspected
SAMPLED_SIDE = 512  # rows and columns of them
MIN_HIGH_BYTES = 32  # values of the high byte from which it varies like a low byte
MIN_BYTES_RATIO = 2.0  # values of the high byte over those of the low byte in samples of swapped bytes
MAX_ROUGHNESS_RATIO = (
    1.25  # roughness with the bytes swapped over that as stored, where bytes alone speak for it
)
MIN_ROUGHNESS_RATIO = 3.0  # roughness as stored over that with the bytes swapped, which alone is enough
MAX_EXTENT, MAX_LIKELY_EXTENT = (
    22.0,
    20.0,
)  # powers of two of samples whose bytes are swapped, and are not
SIGNED_GAP = (
    8192  # counts on both sides of zero that hold no sample where counts above 32767 have become negative
)
MAX_IN_GAP = 0.01  # share of the samples that may lie in it all the same


def in_order(frames: Array, swap: bool | None, source: str, *, advice: str = "") -> Array:
    """Frames (N, h, w) with the bytes of each sample in the right order.

    Args:
        frames: As stored.
        swap: Whether to swap the bytes; None: no, and it is an error where they look swapped.
        source: The file, for messages.
        advice: What else to do about it.

    Raises:
        DataError: They look swapped, and `swap` does not say.
    """
    if swap:
        return swapped(frames)
    if swap is None and are_swapped(frames):
        raise DataError(
            f"{source}: the bytes of its samples look swapped, as of big-endian numbers that a file calls "
            f"little-endian: data.swap_bytes=true swaps them, data.swap_bytes=false takes them as they are{advice}"
        )
    return frames


def swapped(frames: Array) -> Array:
    """Integers with the bytes of each in the opposite order."""
    found: Array = np.ma.getdata(frames).byteswap()
    return np.ma.masked_array(found, np.ma.getmaskarray(frames)) if np.ma.isMaskedArray(frames) else found


def are_swapped(frames: Array) -> bool:
    """Whether samples (N, h, w) are likelier with their bytes swapped.

    The low byte of 16-bit counts takes many values, the high byte few; and pictures are smooth. Longer numbers of
    swapped bytes are far from those that pictures hold.
    """
    if frames.dtype.itemsize > 2:
        return _extent(frames) > MAX_EXTENT > MAX_LIKELY_EXTENT > _extent(frames.byteswap())
    if frames.dtype.kind not in "iu" or frames.dtype.itemsize != 2:
        return False
    some = _some(frames)
    if some.any() and not (some & 0xFF).all():  # counts that are aligned to the left, such as 14 bits x 4
        spare = int(np.bitwise_or.reduce(some, axis=None))
        some = some >> ((spare & -spare).bit_length() - 1)
    low, high = (np.unique(part).size for part in (some & 0xFF, some >> 8))
    here, other = _roughness(some), _roughness(some.byteswap())
    varied = high >= MIN_HIGH_BYTES and high >= MIN_BYTES_RATIO * low
    return (varied and other < MAX_ROUGHNESS_RATIO * here) or here > MIN_ROUGHNESS_RATIO * other > 0


def have_wrapped(frames: Array) -> bool:
    """Whether counts above 32767 have become negative in signed 16-bit samples (..., h, w), none around zero."""
    if frames.dtype.newbyteorder("=") != np.int16:
        return False
    some = _some(frames).view(np.int16)
    above, below = some >= SIGNED_GAP, (some < -SIGNED_GAP) & (some > np.iinfo(np.int16).min + 1)
    return bool(above.any() and below.any() and 1 - (above | below).mean() < MAX_IN_GAP)


def _some(frames: Array) -> Array:
    """Some frames of (..., h, w) as unsigned integers of the machine's order of bytes."""
    frames = np.ma.getdata(frames).reshape(-1, *frames.shape[-2:])
    some = frames[:: -(-len(frames) // SAMPLED_FRAMES), :SAMPLED_SIDE, :SAMPLED_SIDE]
    return some.astype(some.dtype.newbyteorder("="), copy=False).view(np.uint16)


def _extent(frames: Array) -> float:
    """Powers of two between one and a typical sample; below one they count for floats only."""
    some = np.abs(np.ma.getdata(frames)[:1, :SAMPLED_SIDE, :SAMPLED_SIDE].astype(np.float64))
    powers = np.log2(some[np.isfinite(some) & (some > 0)])
    return float(np.median(np.abs(powers) if frames.dtype.kind == "f" else powers)) if powers.size else 0.0


def _roughness(frames: Array) -> float:
    """Mean step from sample to sample over the mean deviation from the median, of (N, h, w)."""
    values = frames.astype(np.float32)
    spread = float(np.abs(values - np.median(values)).mean())
    steps = min(float(np.abs(np.diff(values, axis=axis)).mean()) for axis in (-1, -2))
    return steps / spread if spread else 0.0
