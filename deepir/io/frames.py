"""Read frames from files: which, of what axes, in which units; and masks and a known truth beside them."""

from __future__ import annotations

import hashlib
import itertools
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from deepir.arrays.samples import as_float32
from deepir.config import schema
from deepir.config.schema import Raw
from deepir.errors import DataError
from deepir.io import readers
from deepir.io.guards import judging_colours_in, masked, warn_once
from deepir.io.inspection.checks import Mask, crop
from deepir.io.inspection.samples import (
    BLOCK_SIDE,
    SAMPLED_FRAMES,
    USUAL,
    in_order,
    lost_samples,
    oriented,
    swapped,
    turned_axes,
    wrapped_type,
)
from deepir.io.radiometry import Radiometry, as_of_frame_0
from deepir.io.raw import Headerless
from deepir.io.readers.folder import burst_files
from deepir.io.readers.numpy_arrays import read_npz
from deepir.paths import expanded

Array = np.ndarray[Any, np.dtype[Any]]
Select = str | int | Sequence[int] | None
Shape = tuple[int, int]

MAX_UNSELECTED_PAIRS = 6  # pairs of frames outside a burst that are kept to score its correction
MAX_PAIR_GAP = 8  # frames between the two of a pair
MIN_STEPS = 8  # steps of single precision that a frame spans; fewer hide what it shows
MAX_JUDGED = 10_000  # samples of a frame that are enough to judge that
MAX_BANDS = 16  # along the second axis of an array (N, C, h, w)
JUDGED_BYTES = 2**26  # of the frames from which the axes of a recording that is streamed are judged
_RAW_ORDER = ", and data.raw.endian=big reads big-endian ones"


def selected_in_float32(frames: Array, select: Select, source: str) -> np.ndarray[Any, np.dtype[np.float32]]:
    """The selected frames, see `read_frames`, in float32.

    Raises:
        DataError: `select` does not fit the frames, or they span too little of their level for single precision.
    """
    chosen = select_frames(frames, select, source)
    found = as_float32(chosen)
    if chosen.dtype.kind not in "uif" or np.can_cast(chosen.dtype, np.float32) or not len(chosen):
        return found
    spans, errors, step = [], [], max(1, chosen[0].size // MAX_JUDGED)
    for frame, rounded in zip(chosen, found, strict=True):
        known = np.isfinite(rounded)
        values, steps = np.asarray(frame)[known][::step].astype(np.float64), rounded[known][::step]
        low, high = np.quantile(values, (0.01, 0.99)) if values.size else (0.0, 0.0)
        spans.append(high - low)
        errors.append(np.abs(values - steps).max(initial=0.0))
    if 0 < np.median(spans) < 2 * MIN_STEPS * np.median(errors):
        raise DataError(
            f"{source}: frames span {np.median(spans):.3g} at a level of {np.median(steps):.6g}, which single "
            "precision does not resolve. Subtract the level in double precision, before"
        )
    return found


def select_frames(frames: Array, select: Select, source: str) -> Array:
    """The selected frames, see `read_frames`.

    Raises:
        DataError: `select` does not fit the frames; the message names `source`.
    """
    if select is None:
        return frames
    count = len(frames)
    wrong = DataError(
        f"{source}: data.frames={select!r} does not fit its {count} frames (numbered from 0). "
        "Give a count (8), a slice ('2:10', '::2') or a list of frame numbers ([0, 3, 5])."
    )
    picked = _indices(select, wrong)
    named = [picked.start, picked.stop] if isinstance(picked, slice) else picked
    # A slice's end may be one beyond the last frame.
    limit = count + isinstance(picked, slice)
    if any(i is not None and not -count <= i < limit for i in named) or not len(np.arange(count)[picked]):
        raise wrong
    return frames[picked]


def unselected_pairs(frames: Array, select: Select) -> np.ndarray[Any, np.dtype[np.float32]] | None:
    """Pairs of frames outside the selection, from its neighbourhood.

    The two frames of a pair are half the reach of the burst apart, at most `MAX_PAIR_GAP` frames.

    Args:
        frames: (N, h, w).
        select: The selection, see `read_frames`.

    Returns:
        (2 M, h, w), float32; None if there is no pair.
    """
    if select is None:
        return None
    numbers = np.arange(len(frames))
    taken = select_frames(numbers, select, "frames")
    reach = int(np.ptp(taken))
    gap = int(np.clip(reach // 2, 1, MAX_PAIR_GAP))
    free = ~np.isin(numbers, taken) & (numbers >= taken.min() - reach) & (numbers <= taken.max() + reach + gap)
    starts = numbers[:-gap][free[:-gap] & free[gap:]]
    if not len(starts):
        return None
    some = starts[
        np.unique(np.linspace(0, len(starts) - 1, min(len(starts), MAX_UNSELECTED_PAIRS)).round().astype(int))
    ]
    return as_float32(frames[np.stack((some, some + gap), 1).ravel()])


def _indices(select: str | int | Sequence[int], wrong: DataError) -> slice | list[int]:
    """A slice or a list of a selection; `wrong` is raised if it is neither, or has a step of zero."""
    with suppress(TypeError, ValueError):  # more than three bounds, or no whole numbers
        if isinstance(select, str) and ":" in select:
            found = slice(*(int(part) if part.strip() else None for part in select.split(":")))
            if found.step != 0:
                return found
        elif isinstance(select, str | int) and not isinstance(select, bool):
            if int(select) > 0:
                return slice(0, int(select))
        elif isinstance(select, Sequence) and all(type(i) is int or isinstance(i, np.integer) for i in select):
            return [int(i) for i in select]
    raise wrong


@dataclass(frozen=True)
class Frames:
    """A burst from a file.

    Attributes:
        frames: (N, h, w), or (N, C, h, w) of several bands, float32, in the data's units.
        source: The file, for messages.
        dtype: Type in which the frames were stored.
        sha256: Digest of the file; of several files, of their digests in order.
        radiometry: Conversion to kelvin, if the file has it.
        beside: (2 M, h, w), pairs of frames that were not selected.
    """

    frames: np.ndarray[Any, np.dtype[np.float32]]
    source: str
    dtype: str
    sha256: str
    radiometry: Radiometry | None = None
    beside: np.ndarray[Any, np.dtype[np.float32]] | None = None


def read_frames(
    path: str | os.PathLike[str],
    *,
    key: str | None = None,
    select: Select = None,
    raw: Raw | None = None,
    axes: str | None = None,
    swap_bytes: bool | None = None,
    radiometry: schema.Radiometry | None = None,
    grey_within: Sequence[int] | None = None,
    bands: bool = False,
) -> Frames:
    """Read frames from a file, a folder of pictures or a glob; the contents decide the format.

    Args:
        path: The file, folder or glob.
        key: Name of the array in a file that holds several.
        select: The first n frames (`8`), a slice (`"2:10"`, `"::2"`) or a list of frame numbers.
        raw: Layout of a file without a header.
        axes: What each axis of a stack counts, such as "hwn"; None: frames first; one that looks turned is an error.
        swap_bytes: Whether to swap the bytes of each sample; None: no, and samples that look swapped are an error.
        radiometry: The user's settings: frames of other constants are converted to what frame 0 would have counted.
        grey_within: [y0, y1, x0, x1], the part in which a picture has to be grey; None: the whole picture.
        bands: Whether frames of several bands are taken.

    Raises:
        DataError: It cannot be read, or holds no burst of numbers.
    """
    recording = _opened(path, key, raw)
    file, source = recording.path, recording.source
    with judging_colours_in(grey_within):
        stored = recording.read()
    if bands and is_banded(stored):
        selected = as_float32(select_frames(stored, select, source))
        return Frames(selected, source, stored.dtype.name, digest(file))
    stored = to_stack(stored, str(file))
    dtype = stored.dtype
    stored = oriented(stored, axes or (None if recording.reader.any_axes else USUAL), source)
    (stored,) = _unwrapped([in_order(stored, swap_bytes, source, advice=_RAW_ORDER if raw else "")], source)
    laws = recording.radiometries()
    if len(laws) > 1:
        stored = np.ma.stack([*as_of_frame_0(stored, laws, radiometry, source)])
    frames = selected_in_float32(stored, select, source)
    if (lost := lost_samples(frames, dtype)) is not None:
        frames[lost] = np.nan
    return Frames(frames, source, dtype.name, digest(file), laws[0], unselected_pairs(stored, select))


def _as_stored(data: schema.Data) -> Iterator[Array]:
    """Frame after frame (h, w), all of each; lost samples are masked."""
    recording = _opened(str(data.path), data.key, data.raw)
    source, any_axes = recording.source, recording.reader.any_axes
    first = _first_frames(_stream(recording), BLOCK_SIDE if any_axes else SAMPLED_FRAMES)
    if data.axes not in (None, USUAL) or (data.axes is None and any_axes and turned_axes(first) is not None):
        first = oriented(to_stack(recording.read(), str(recording.path)), data.axes, source)
        frames = iter(first)
    else:
        frames = _stream(recording)
    first = in_order(first, data.swap_bytes, source, advice=_RAW_ORDER if data.raw else "")
    frames = map(swapped, frames) if data.swap_bytes else frames
    frames = itertools.islice(_unwrapped(itertools.chain([first], frames), source), 1, None)  # first ones as the rest
    laws = recording.radiometries()
    if len(laws) > 1:
        frames = as_of_frame_0(frames, laws, data.radiometry, source)
    for frame in frames:
        lost = lost_samples(np.ma.getdata(frame)[None], frame.dtype)
        yield frame if lost is None else masked(frame, lost[0])


def read_data(data: schema.Data, *, bands: bool = False) -> Frames:
    """`read_frames` with the settings of a configuration; `data.crop` is left to the caller."""
    layout = {name: getattr(data, name) for name in ("key", "raw", "axes", "swap_bytes", "radiometry")}
    return read_frames(str(data.path), select=data.frames, grey_within=data.crop, bands=bands, **layout)


def stream_data(data: schema.Data) -> Iterator[Array]:
    """Frame after frame (h, w), in the stored type, cropped, of a recording that may be larger than the memory.

    Raises:
        DataError: As `read_frames`.
    """
    frames = _as_stored(data)
    return cropped(frames if data.frames is None else _chosen(frames, data.frames), data.crop)


def _chosen(frames: Iterator[Array], select: str | int | Sequence[int]) -> Iterator[Array]:
    """The frames of a stream that `data.frames` names, counted from its start."""
    wrong = DataError(
        f"data.frames={select!r} names no frames of the recording. Give a count (8), a slice ('2:10', '::2') or a list "
        "of frame numbers ([0, 3, 5]), counted from the start"
    )
    which = _indices(select, wrong)
    ends = (which.start, which.stop, which.step) if isinstance(which, slice) else tuple(which)
    if any(end is not None and end < 0 for end in ends):
        raise wrong
    numbered = enumerate(frames)
    chosen = itertools.islice(numbered, *ends) if isinstance(which, slice) else (k for k in numbered if k[0] in ends)
    first = next(chosen, None)
    if first is None:
        raise wrong
    return (frame for _, frame in itertools.chain((first,), chosen))


def cropped(frames: Iterable[Array], box: Sequence[int] | None) -> Iterator[Array]:
    """The part `data.crop` of frame after frame; all of each if it is None."""
    return iter(frames) if box is None else (crop(frame, box) for frame in frames)


def _opened(path: str | os.PathLike[str], key: str | None, raw: Raw | None) -> readers.Recording:
    """A recording with or without a header."""
    file = expanded(path)
    return readers.opened(file, key) if raw is None else readers.Recording(file, Headerless(raw), key)


def _stream(recording: readers.Recording) -> Iterator[Array]:
    """Frame after frame (h, w) as stored."""
    for piece in recording.stream():
        yield from to_stack(piece, str(recording.path))


def _first_frames(frames: Iterable[Array], count: int) -> Array:
    """Up to `count` first frames, of up to `JUDGED_BYTES`; those before a break."""
    taken: list[Array] = []
    try:
        for frame in frames:
            if len(taken) == count or sum(each.nbytes for each in taken) > JUDGED_BYTES:
                break
            if taken and frame.shape != taken[0].shape:
                break
            taken.append(frame)
    except DataError:
        if not taken:
            raise
    return np.ma.stack(taken) if any(map(np.ma.isMaskedArray, taken)) else np.stack(taken)


def _unwrapped(pieces: Iterable[Array], source: str) -> Iterator[Array]:
    """Counts of the type that they were recorded in, from the first piece on that has passed an end of its range."""
    whole: type[np.generic] | None = None
    for piece in pieces:
        if whole is None:
            frames = piece if piece.ndim == 3 else piece[None]
            whole = next((found for each in frames if (found := wrapped_type(each)) is not None), None)
            if whole is not None:
                before, after = ("above 32767", "negative") if whole is np.uint16 else ("below zero", "large")
                warn_once(f"{source}: counts {before} are stored as {after} ones; they are read as they were")
        yield piece if whole is None else piece.astype(piece.dtype.newbyteorder("=")).view(whole)


def digest(path: str | os.PathLike[str]) -> str:
    """SHA-256 of a burst's file, or of the digests of its pictures in order.

    Raises:
        DataError: It cannot be read.
    """
    file = expanded(path)
    with readers.decoding(file):
        if file.is_dir() or readers.is_glob(file):
            return hashlib.sha256("".join(map(digest, burst_files(file))).encode()).hexdigest()
        with readers.samples_file(file).open("rb") as samples:
            return hashlib.file_digest(samples, "sha256").hexdigest()


def is_banded(array: Array) -> bool:
    """Whether an array holds frames of several bands, (N, C, h, w), and no colours, (N, h, w, 3)."""
    return array.ndim == 4 and array.dtype.kind in "uif" and 1 < array.shape[1] <= min(MAX_BANDS, array.shape[3])


def to_stack(array: Array, source: str) -> Array:
    """Frames (N, h, w) of an array (h, w), (h, w, 1), (N, h, w), (N, 1, h, w) or (N, h, w, 1).

    Raises:
        DataError: The shape is another, or values are neither integers nor floats; the message names `source`.
    """
    if array.dtype.kind not in "uif":
        raise DataError(f"{source}: values of type {array.dtype}; frames are integers or real numbers")
    shape = array.shape
    if array.ndim == 4 and shape[1] == 1:
        array = array[:, 0]
    elif array.ndim == 4 and shape[3] == 1:
        array = array[..., 0]
    elif array.ndim == 2:
        array = array[None]
    elif array.ndim == 3 and shape[2] == 1 < shape[1]:
        array = array[None, ..., 0]
    if array.ndim == 4 and 0 not in shape:
        one = "frames[:, 0]" if shape[1] < shape[3] else "frames[..., 0]"
        raise DataError(
            f"{source}: an array of shape {shape}; expected (frames, height, width): give one channel, {one}. "
            "`deepir run` and deepir.run take several bands, (frames, bands, height, width)"
        )
    if array.ndim != 3 or 0 in shape:
        raise DataError(f"{source}: an array of shape {shape}; expected (frames, height, width) or (height, width)")
    return array


def read_mask(path: str | os.PathLike[str], shape: Shape) -> Mask:
    """Mask (h, w) of pixels to ignore: True where an array or a picture is nonzero.

    Args:
        path: The file.
        shape: Height and width of a frame.

    Raises:
        DataError: It has another shape, or ignores every pixel.
    """
    file = expanded(path)
    array = readers.opened(file).read()
    if array.dtype.kind == "b":
        array = array.astype(np.uint8)
    mask = np.ma.getdata(to_stack(array, str(file))) != 0
    if mask.shape != (1, *shape):
        raise DataError(f"{file}: the mask is {_size(mask.shape)}, the frames are {_size(shape)}")
    if mask.all():
        raise DataError(f"{file}: the mask ignores every pixel; anything but zero means `ignore`")
    return mask[0]


def read_truth(path: str | os.PathLike[str], shape: Shape) -> dict[str, np.ndarray[Any, np.dtype[np.float32]]]:
    """Known arrays of simulated or calibrated data by name, float32.

    An `.npz` has `scene`, and may have gain, offset, motion ...; any other file is a picture of the scene.

    Args:
        path: The file.
        shape: Height and width of a frame.

    Returns:
        Arrays by name; the scene is (Q h, Q w) with an integer Q, or (N, Q h, Q w) with a scene for each frame.

    Raises:
        DataError: There is no scene, or it does not fit `shape`.
    """
    file = expanded(path)
    named = read_npz(file)
    return fit_truth({"scene": readers.opened(file).read()} if named is None else named, shape, str(file))


def fit_truth(
    arrays: dict[str, readers.Array], shape: Shape, source: str
) -> dict[str, np.ndarray[Any, np.dtype[np.float32]]]:
    """Check that a known scene fits frames of a `shape`, and give all known arrays by name, float32.

    Raises:
        DataError: There is no scene, or it does not fit; the message names the `source`.
    """
    if "scene" not in arrays:
        raise DataError(f"{source}: a truth needs an array `scene`; this has {', '.join(sorted(arrays))}")
    scene = to_stack(arrays["scene"], f"{source}[scene]")
    factor = max(1, scene.shape[1] // shape[0])
    if scene.shape[1:] != (factor * shape[0], factor * shape[1]):
        raise DataError(
            f"{source}: the scene is {_size(scene.shape)}, expected {_size(shape)}, or both sides a multiple of it"
        )
    arrays = arrays | {"scene": scene[0] if len(scene) == 1 else scene}
    return {name: as_float32(array) for name, array in arrays.items() if array.dtype.kind in "uif"}


def _size(shape: tuple[int, ...]) -> str:
    return " x ".join(str(n) for n in (shape[1:] if shape[0] == 1 else shape)) + " px"
