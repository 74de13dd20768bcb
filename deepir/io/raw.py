"""Headerless recordings, such as a Lepton's Y16 dump, with a layout that the user gives."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deepir.config.schema import Raw
from deepir.errors import DataError
from deepir.io.guards import stream_planes, warn_once
from deepir.io.readers import Array, Reader

MIN_WIDTH, MIN_ROWS = 24, 8  # px of a width that is looked for, and rows of it
OUTLIER = 8.0  # medians of a change, at which changes are clipped
MIN_RECURRENCE = 0.1  # correlation of changes one row below
#: Ratio of that correlation to the one at the width that was given, at a smaller and at a larger width: rows of
#: interlaced frames continue each other at twice the width.
WIDTH_RATIOS = 1.1, 1.5


@dataclass(frozen=True)
class Headerless(Reader):
    """Frames of uint8 or uint16 unless the layout names another type; bits above the layout's are cleared."""

    layout: Raw

    def stream(self, path: Path, key: str | None) -> Iterator[Array]:
        """Frame after frame (h, w)."""
        dtype, shape = stored_array(path, self.layout)
        gap = self.layout.gap
        for number, stored in enumerate(stream_planes(path, dtype, self.layout.offset, shape, gap)):
            frame = clear_unused_bits(stored, self.layout)
            if number == 0:
                _hint_at_width(frame, path)
            yield frame


def stored_array(path: Path, layout: Raw) -> tuple[np.dtype[Any], tuple[int, int, int]]:
    """Type and shape (N, h, w) of the samples."""
    dtype = sample_type(layout)
    frame = layout.height * layout.width * dtype.itemsize
    stored = max(0, path.stat().st_size - layout.offset - layout.trailer)
    count, rest = divmod(stored + layout.gap, frame + layout.gap)
    if not count or rest not in (0, layout.gap):
        spare = f", {count} frame(s) and {rest:,} bytes: if these are no picture, data.raw.trailer={rest} skips them"
        raise DataError(
            f"{path}: data.raw does not fit: after {layout.offset} bytes there are {stored:,}, and a frame of "
            f"{layout.height} x {layout.width} px of {8 * dtype.itemsize if layout.type else layout.bits} bits takes "
            f"{frame:,}{spare if count else ''}"
        )
    return dtype, (count, layout.height, layout.width)


def _hint_at_width(frame: Array, path: Path) -> None:
    """Warn if rows of another width continue each other better: changes along a row recur in the one below."""
    height, width = frame.shape
    change = np.diff(frame.ravel().astype(float))
    spread = np.median(np.abs(change))
    change = np.clip(change - np.median(change), -OUTLIER * spread, OUTLIER * spread)
    spectrum = np.fft.rfft(change, 2 * len(change))
    recurs = np.fft.irfft(np.abs(spectrum) ** 2)[: len(change) // MIN_ROWS]
    if len(recurs) <= max(width, MIN_WIDTH) or not recurs[0] > 0:
        return
    best = MIN_WIDTH + int(recurs[MIN_WIDTH:].argmax())
    ratio = WIDTH_RATIOS[best > width]
    if recurs[best] > MIN_RECURRENCE * recurs[0] and recurs[best] > ratio * recurs[width]:
        other = f" data.raw.height={height * width // best}" if height * width % best == 0 else ""
        warn_once(
            f"{path}: rows of {width} px do not continue each other, as rows of {best} px would: stripes instead of a "
            f"picture? Try data.raw.width={best}{other}"
        )


def sample_type(layout: Raw) -> np.dtype[Any]:
    """Type of a stored sample, byte order included."""
    name = layout.type or ("uint8" if layout.bits <= 8 else "uint16")
    return np.dtype(name).newbyteorder("<" if layout.endian == "little" else ">")


def clear_unused_bits(samples: Array, layout: Raw) -> Array:
    """Samples in the machine's byte order, without the bits above the layout's, if it does not name their type."""
    kept = samples if layout.type else samples & samples.dtype.type(2**layout.bits - 1)
    return kept.astype(kept.dtype.newbyteorder("="), copy=False)
