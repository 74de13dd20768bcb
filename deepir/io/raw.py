"""Headerless recordings, such as a Lepton's Y16 dump, with a layout that the user gives."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from deepir.config.schema import Raw
from deepir.errors import DataError
from deepir.io.guards import check_size
from deepir.io.readers import Array, decoding


def read(path: Path, layout: Raw) -> Array:
    """All frames (N, h, w), uint8 or uint16; bits above the layout's are cleared.

    Raises:
        DataError: The file is missing, or does not hold a whole number of such frames.
    """
    with decoding(path):
        frames = map_frames(path, layout)
        check_size(path, frames.nbytes, frames.nbytes)
        return clear_unused_bits(frames, layout)


def stream(path: Path, layout: Raw) -> Iterator[Array]:
    """Frame after frame (h, w), as `read` gives them."""
    with decoding(path):
        frames = map_frames(path, layout)
    yield from (clear_unused_bits(frame, layout) for frame in frames)


def map_frames(path: Path, layout: Raw) -> Array:
    """Memory map (N, h, w) of the samples."""
    dtype = np.dtype("u1" if layout.bits <= 8 else f"{'<' if layout.endian == 'little' else '>'}u2")
    frame = layout.height * layout.width * dtype.itemsize
    stored = path.stat().st_size - layout.offset
    if stored <= 0 or stored % frame:
        raise DataError(
            f"{path}: data.raw does not fit: after {layout.offset} bytes there are {max(stored, 0):,}, and a frame of "
            f"{layout.height} x {layout.width} px of {layout.bits} bits takes {frame:,}"
        )
    shape = (stored // frame, layout.height, layout.width)
    return np.memmap(path, dtype, "r", layout.offset, shape)


def clear_unused_bits(samples: Array, layout: Raw) -> Array:
    """Samples in the machine's byte order, without the bits above the layout's."""
    kept: Array = samples & samples.dtype.type(2**layout.bits - 1)
    return kept.astype(kept.dtype.newbyteorder("="), copy=False)
