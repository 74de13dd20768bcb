"""The samples of a file: how they are stored, which axis counts the frames, and which say nothing of the scene."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.ndimage import convolve

from deepir.arrays.samples import as_float32
from deepir.errors import DataError
from deepir.io.inspection.checks import MIN_FRAME_SIDE, Mask
from deepir.messages import Message

Array = np.ndarray[Any, np.dtype[Any]]

USUAL = "nhw"  # frames, height, width
TURNED = ("hwn", "wnh")  # frames counted along the last axis, and an array (N, h, w) of MATLAB
MAX_ASPECT = 4.0  # of a frame's sides, above which another reading is looked for
USUAL_ASPECT = 2.0  # of the sides in that reading, at most
#: Heights and widths of thermal detectors, px.
DETECTORS = {
    *((60, 80), (120, 160), (156, 208), (192, 256), (240, 320), (256, 320), (256, 336), (288, 382), (288, 384)),
    *((480, 640), (512, 640), (768, 1024), (1024, 1280)),
}
BLOCK_SIDE = 96  # samples along an axis that are compared
LAGS = (1, 8)  # samples between those that are compared
MIN_PERSISTENCE = 0.25  # correlation at the longer lag along the axis of frames, which hold one fixed pattern
MIN_PERSISTENCE_RATIO = 0.5  # of the correlations at the longer and the shorter lag; a scene's texture has less
MAX_OTHER_PERSISTENCE = 0.5  # correlation at the longer lag along the first axis over that along the axis of frames
MAX_DIFFERENCE = 0.3  # of the correlations at the shorter lag along both axes of a frame
MIN_TEXTURE = 0.5  # correlation at the shorter lag along both axes of frames of a scene without a fixed pattern
MAX_MOVING_TEXTURE = 0.1  # the same along the axis of the frames, where that scene jumps
MAX_CLIPPED_SHARE = 0.5  # share of a frame at the ends of the range from which its samples are kept
MAX_DRAWN_SHARE = 0.2  # of the pixels; more: the frames hardly change
MIN_DRAWN_NEIGHBOURS = 2  # of the eight around a pixel that are drawn too; fewer: a dead pixel
MIN_DRAWN_PIXELS = 20  # fewer are defective ones
COMMON_VALUES, MIN_COMMON_SHARE = 3, 0.6  # shades of what is drawn, and share of its pixels that have them
#: Of GDAL, Pix4D, ENVI, NetCDF and others, for floats and signed integers.
FILL_VALUES = (
    *(-9999.0, 9999.0, -99999.0, 99999.0, -999.0, -10000.0, -32768.0, -32767.0, -2147483648.0),
    *(-3.4028234663852886e38, 3.4028234663852886e38, 1e20, -1e20, 9.969209968386869e36, -1e30, 1e30, -1e31),
)
UNSIGNED_FILL = 65535.0  # of 16-bit counts
MIN_ZERO_GAP = 0.25  # of the range of the others, between which and a zero among floats no sample lies
SAMPLES = 100_000  # that the range of the others is measured of
FULL_SCALE_COUNTS = tuple(2**bits - 1 for bits in (8, 10, 12, 14, 15, 16))  # largest ones of common converters
CHANCE_COUNT = 20  # samples that may share an end of the range by chance
PILE_UP_RATIO = 4.0  # samples at an end of the range over those at a neighbouring value
NEIGHBOUR_VALUES = 5  # neighbouring values that are compared
SAMPLED_FRAMES = 4  # frames that are inspected
SAMPLED_SIDE = 512  # rows and columns of them
MIN_HIGH_BYTES = 32  # values of the high byte from which it varies like a low byte
MIN_BYTES_RATIO = 2.0  # values of the high byte over those of the low byte in samples of swapped bytes
MAX_ROUGHNESS_RATIO = 1.25  # roughness with the bytes swapped over that as stored, where bytes alone speak for it
MIN_ROUGHNESS_RATIO = 3.0  # roughness as stored over that with the bytes swapped, which alone is enough
MAX_EXTENT, MAX_LIKELY_EXTENT = 22.0, 20.0  # powers of two of samples whose bytes are swapped, and are not
SIGNED_GAP = 8192  # counts on both sides of zero that hold no sample where counts above 32767 have become negative
MAX_IN_GAP = 0.01  # share of the samples that may lie in it all the same


def oriented(frames: Array, axes: str | None, source: str) -> Array:
    """Frames (N, h, w) of an array whose `axes` are named in order, such as "hwn".

    Args:
        frames: Three axes.
        axes: None: `USUAL`, unless the array looks turned.
        source: The file, for messages.

    Raises:
        DataError: It looks turned, and `axes` does not say.
    """
    if axes is None:
        if (likely := turned_axes(frames)) is not None:
            count, other = frames.shape[0], frames.shape[likely.index("n")]
            raise DataError(
                f"{source}: {count} frames of {frames.shape[1]} x {frames.shape[2]} px, or {other} frames counted "
                f"along another axis? data.axes={likely} reads {other} frames, data.axes={USUAL} reads it as it is"
            )
        return frames
    return frames.transpose([axes.index(each) for each in USUAL])


def turned_axes(frames: Array) -> str | None:
    """The likely axes of an array that is read as (N, h, w) but is not; None if nothing speaks for that.

    Small frames speak for it; long and narrow ones, and those whose other sides are a detector's, unless a fixed
    pattern goes on along the first axis; a fixed pattern along another axis; and a scene that is continuous along the
    first axis but not along another.
    """
    shape = frames.shape
    block = as_float32(np.ma.getdata(frames)[:BLOCK_SIDE, :BLOCK_SIDE, :BLOCK_SIDE])
    is_large = min(block.shape) > LAGS[-1] + 1
    correlations = [_correlations(block, axis) if is_large else [0.0, 0.0] for axis in range(3)]
    first = correlations[0]
    for axes in TURNED:
        height, width, count = (shape[axes.index(each)] for each in "hwn")
        if count == 1 or min(height, width) < MIN_FRAME_SIDE:
            continue
        along = correlations[axes.index("n")]
        side = correlations[3 - axes.index("n")]  # the other axis of a frame beside the first
        aspect = max(shape[1:]) / min(shape[1:])
        narrow = aspect > MAX_ASPECT and max(height, width) <= USUAL_ASPECT * min(height, width)
        known = (height, width) in DETECTORS and (shape[1], shape[2]) not in DETECTORS
        goes_on = first[1] > MIN_PERSISTENCE and along[1] < MAX_OTHER_PERSISTENCE * first[1]
        pattern = (
            along[1] > max(MIN_PERSISTENCE, MIN_PERSISTENCE_RATIO * along[0])
            and first[1] < MAX_OTHER_PERSISTENCE * along[1]
            and abs(first[0] - side[0]) < MAX_DIFFERENCE
        )
        texture = all(each[0] > max(MIN_TEXTURE, each[1] / MIN_PERSISTENCE_RATIO) for each in (first, side))
        moves = texture and abs(along[0]) < MAX_MOVING_TEXTURE
        if count < MIN_FRAME_SIDE or ((narrow or known) and not goes_on) or pattern or moves:
            return axes
    return None


def _correlations(block: Array, axis: int) -> list[float]:
    """Correlation of the diagonal detail across the two other axes, at lags along one."""
    x = np.nan_to_num(np.moveaxis(block, axis, 0), posinf=0, neginf=0)
    detail = x[:, :-1, :-1] - x[:, 1:, :-1] - x[:, :-1, 1:] + x[:, 1:, 1:]
    most = 3 * float(np.median(np.abs(detail)))  # defective pixels and edges count no more than others
    detail = np.clip(detail, -most, most)
    power = float((detail * detail).mean())
    return [float((detail[:-lag] * detail[lag:]).mean()) / power if power else 0.0 for lag in LAGS]


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


def wrapped_type(frames: Array) -> type[np.generic] | None:
    """The type as which 16-bit samples (..., h, w) that passed an end of their range are whole again, None if none did.

    Signed ones above 32767 have become negative, unsigned ones below zero large: none lies between, and pictures step
    from one end to the other.
    """
    kind = frames.dtype.newbyteorder("=")
    if kind not in (np.dtype(np.int16), np.dtype(np.uint16)):
        return None
    some = _some(frames)
    signed = some.view(np.int16)
    if kind == np.int16:
        above, below = signed >= SIGNED_GAP, (signed < -SIGNED_GAP) & (signed > np.iinfo(np.int16).min + 1)
        found: type[np.generic] = np.uint16
    else:
        above = signed >= 0
        below = (signed < -1) & (signed > -SIGNED_GAP)  # 65535 is a fill value
        ends = (some < SIGNED_GAP) & above
        if not ends.any() or mean_step(some) < MIN_ROUGHNESS_RATIO * mean_step(signed):
            return None
        found = np.int16
    whole = above.any() and below.any() and 1 - (above | below).mean() < MAX_IN_GAP
    return found if whole else None


def mean_step(samples: Array) -> float:
    """Mean step along the rows of samples (..., h, w)."""
    return float(np.abs(np.diff(samples.astype(np.float32))).mean()) if samples.shape[-1] > 1 else 0.0


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
    axes = [axis for axis in (-1, -2) if values.shape[axis] > 1]
    steps = min((float(np.abs(np.diff(values, axis=axis)).mean()) for axis in axes), default=0.0)
    return steps / spread if spread else 0.0


def is_contrast_stretched(frames: Array) -> bool:
    """True if frames may have individual contrasts: 8 bits, or all of one range.

    An automatic gain control gives such frames, and so does normalisation of each frame to [0, 1]. Pixels at an end of
    the range in all frames are dead and are ignored.

    Args:
        frames: (N, h, w), NaN where unknown.
    """
    low, high = np.nanmin(frames), np.nanmax(frames)
    if low >= 0 and 1 < high <= 255 and np.array_equal(frames, np.rint(frames), equal_nan=True):
        return True
    return all((end & ~end.all(0)).any((1, 2)).all() for end in (frames == low, frames == high))


def clipped_samples(frames: Array) -> Array:
    """Samples of frames (N, h, w), bool, at an end of the range; none of frames that mostly are."""
    cut = (frames == np.nanmin(frames)) | (frames == np.nanmax(frames))
    return np.asarray(cut & (cut.mean((1, 2), keepdims=True) < MAX_CLIPPED_SHARE))


def drawn_pixels(frames: Array) -> Mask:
    """Pixels (h, w), bool, that text or marks cover in all frames (N, h, w); none of frames that are all alike."""
    same = (frames == frames[:1]).all(0)
    if len(frames) < 2 or same.mean() > MAX_DRAWN_SHARE:
        return np.zeros_like(same)
    around = convolve(same.astype(np.int8), np.ones((3, 3), np.int8), mode="constant") - same
    drawn: Mask = same & (around >= MIN_DRAWN_NEIGHBOURS)
    shades = np.sort(np.unique(frames[0][drawn], return_counts=True)[1])
    is_drawn = drawn.sum() >= MIN_DRAWN_PIXELS and shades[-COMMON_VALUES:].sum() >= MIN_COMMON_SHARE * drawn.sum()
    return drawn if is_drawn else np.zeros_like(same)


def drawn_message(drawn: Mask) -> list[str]:
    """A warning on pixels (h, w) that text or marks cover; [] if there are none."""
    if not drawn.any():
        return []
    y, x = drawn.nonzero()
    return [
        Message(
            "drawn-pixels",
            f"{len(y)} pixel(s) between rows {y.min()} and {y.max()}, columns {x.min()} and {x.max()} hold one value "
            "in all frames: text or marks that are drawn over the picture, or cut off at an end of the range. "
            "data.mask, or data.crop, leaves them out",
        )
    ]


def lost_samples(frames: Array, stored: np.dtype[Any]) -> Mask | None:
    """Samples that hold a fill value, further away from all others than their range.

    Args:
        frames: (N, h, w), float32.
        stored: Type that they were stored in: unsigned counts have no fill value but the largest of 16 bits.

    Returns:
        (N, h, w) bool; None if there are none.
    """
    if stored.kind == "u" and stored.itemsize != 2:
        return None
    values = (UNSIGNED_FILL,) if stored.kind == "u" else FILL_VALUES
    if stored.kind == "f":
        values = (*values, 0.0)
    found = None
    least, largest = np.fmin.reduce(frames, axis=None), np.fmax.reduce(frames, axis=None)
    for value in (each for each in values if least <= np.float32(each) <= largest):
        if not (lost := frames == np.float32(value)).any() or lost.all():
            continue
        others = frames[~lost]
        others = others[:: max(1, len(others) // SAMPLES)]
        others = others[np.isfinite(others) & ~np.isin(others, np.array(values, np.float32))]
        if not len(others):
            continue
        low, high = float(others.min()), float(others.max())
        gap = MIN_ZERO_GAP if value == 0 else 1.0
        if max(low - value, value - high) > gap * (high - low):
            found = lost if found is None else found | lost
    return found


def saturated_samples(frames: Array) -> Array | None:
    """Samples that are cut off at an end of the range.

    Integers cannot exceed the largest value of a converter. A cut-off end of the range holds many more samples than any
    neighbouring value. Pixels at the end in all frames are ignored: they may be dead.

    Args:
        frames: (N, h, w), NaN where unknown.

    Returns:
        (N, h, w), int8: 1 at the top, -1 at the bottom, else 0; None if nothing is cut off.
    """
    found = np.zeros(frames.shape, np.int8)
    for sign, end in ((1, np.nanmax(frames)), (-1, np.nanmin(frames))):
        there = frames == end
        passing = int((there & ~(there | np.isnan(frames)).all(0)).sum())
        limit = end in FULL_SCALE_COUNTS and sign > 0 and np.array_equal(frames, np.rint(frames), equal_nan=True)
        if (passing and limit) or (passing >= CHANCE_COUNT and _piled_up(sign * frames, passing)):
            found[there] = sign
    return found if found.any() else None


def _piled_up(frames: Array, count: int) -> bool:
    """True if `count` is far above the number of samples at any value next to the largest."""
    _, counts = np.unique(frames[np.isfinite(frames)], return_counts=True)
    return len(counts) > 1 and count > PILE_UP_RATIO * counts[-NEIGHBOUR_VALUES - 1 : -1].max()
