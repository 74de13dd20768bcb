"""Headerless recordings, such as a Lepton's Y16 dump, with a layout that the user gives."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deepir.config.schema import Raw
from deepir.errors import DataError
from deepir.io.file_bytes import read_samples, stream_planes
from deepir.io.readers import Array, Reader


@dataclass(frozen=True)
class Headerless(Reader):
    """Frames of uint8 or uint16 unless the layout names another type; bits above the layout's are cleared."""

    layout: Raw

    def read(self, path: Path, key: str | None) -> Array:
        """All frames (N, h, w).

        Raises:
            DataError: The file does not hold a whole number of such frames.
        """
        dtype, shape = stored_array(path, self.layout)
        samples = read_samples(path, dtype, self.layout.offset, shape)
        return clear_unused_bits(samples, self.layout)

    def stream(self, path: Path, key: str | None) -> Iterator[Array]:
        """Frame after frame (h, w)."""
        dtype, shape = stored_array(path, self.layout)
        for frame in stream_planes(path, dtype, self.layout.offset, shape):
            yield clear_unused_bits(frame, self.layout)


def stored_array(path: Path, layout: Raw) -> tuple[np.dtype[Any], tuple[int, int, int]]:
    """Type and shape (N, h, w) of the samples."""
    dtype = sample_type(layout)
    frame = layout.height * layout.width * dtype.itemsize
    stored = path.stat().st_size - layout.offset
    if stored <= 0 or stored % frame:
        raise DataError(
            f"{path}: data.raw does not fit: after {layout.offset} bytes there are {max(stored, 0):,}, and a frame of "
            f"{layout.height} x {layout.width} px of {8 * dtype.itemsize if layout.type else layout.bits} bits takes "
            f"{frame:,}"
        )
    return dtype, (stored // frame, layout.height, layout.width)


def sample_type(layout: Raw) -> np.dtype[Any]:
    """Type of a stored sample, byte order included."""
    name = layout.type or ("uint8" if layout.bits <= 8 else "uint16")
    return np.dtype(name).newbyteorder("<" if layout.endian == "little" else ">")


def clear_unused_bits(samples: Array, layout: Raw) -> Array:
    """Samples in the machine's byte order, without the bits above the layout's, if it does not name their type."""
    kept = samples if layout.type else samples & samples.dtype.type(2**layout.bits - 1)
    return kept.astype(kept.dtype.newbyteorder("="), copy=False)
