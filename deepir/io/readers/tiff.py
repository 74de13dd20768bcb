"""TIFF of one or many pages, 8 to 64 bit, integer or float, in any compression that imagecodecs knows."""

from __future__ import annotations

import json
import logging
import math
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import tifffile

from deepir.config import schema
from deepir.errors import ConfigError, DataError
from deepir.io.guards import FileBytes, check_size, masked, stream_planes, to_grey
from deepir.io.radiometry import KELVIN, Radiometry, resolve_radiometry
from deepir.io.readers import Array, Reader

GDAL_NODATA = 42113  # the tag of the value of lost samples, a text

# Python prints messages of a library's logger that nobody handles; ours become errors instead.
logging.getLogger("tifffile").addHandler(logging.NullHandler())


class Tiff(Reader):
    """TIFF and BigTIFF, in either byte order."""

    name = "tiff"
    suffixes = (".tif", ".tiff")
    signatures = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
    any_axes = True

    def stream(self, path: Path, key: str | None) -> Iterator[Array]:
        """Page after page (h, w)."""
        with _open(path) as tiff:
            for part in _series(tiff, path):
                if part.dataoffset is not None:
                    dtype = part.dtype.newbyteorder(tiff.byteorder)
                    page = part.keyframe.shape  # the last axes of the series
                    whole = (math.prod(part.shape) // math.prod(page), *page)
                    for plane in stream_planes(path, dtype, part.dataoffset, whole):
                        yield _stack(plane, part.keyframe.axes, path, nodata=_nodata(part))
                else:
                    for page in part.pages:
                        yield _stack(page.asarray(), part.axes, path, nodata=_nodata(part))

    def radiometries(self, path: Path, key: str | None) -> list[Radiometry | None]:
        """Radiometry that deepir wrote into the description, see `deepir.io.radiometry.unit_metadata`."""
        with _open(path) as tiff:
            try:
                description = json.loads(tiff.pages.first.description)
                if description.get("unit") == "K":
                    return [KELVIN]
                return [resolve_radiometry(None, schema.Radiometry(**description["radiometry"]))]
            except (ValueError, TypeError, KeyError, AttributeError, ConfigError):  # anybody else's description
                return [None]


def _open(path: Path) -> tifffile.TiffFile:
    """A TIFF whose directories are whole: of a broken chain tifffile would only log an error."""
    directories = _count_directories(path)
    # OME metadata may name other files, which would be opened: read this file's own pages only.
    tiff = tifffile.TiffFile(path, is_ome=False)
    if len(tiff.pages) < directories:
        tiff.close()
        raise DataError(f"{path}: damaged: only {len(tiff.pages)} of its {directories} pages can be found")
    return tiff


def _count_directories(path: Path) -> int:
    """Number of the directories of a TIFF or BigTIFF, without sub-directories, of which tifffile follows one level.

    Raises:
        DataError: One is reached twice, or lies outside the file. What else is wrong is left to the library that reads.
    """
    with FileBytes(path) as data:
        order = "<" if data[:2] == b"II" else ">"
        large = struct.unpack(f"{order}H", data[2:4])[0] == 43
        offset, count, entry, width = ("Q", "Q", 20, 8) if large else ("I", "H", 12, 4)
        (at,) = struct.unpack(order + offset, data[width : 2 * width])
        seen = set[int]()
        while at:
            if at in seen:
                raise DataError(f"{path}: damaged: its directory at byte {at} is reached twice")
            seen.add(at)
            start = at + struct.calcsize(order + count)
            end = start + entry * struct.unpack(order + count, data[at:start])[0]
            if end + width > len(data):
                raise DataError(f"{path}: truncated: its directory at byte {at} lies outside the file")
            (at,) = struct.unpack(order + offset, data[end : end + width])
        return len(seen)


def _series(tiff: tifffile.TiffFile, path: Path) -> list[Any]:
    series = [part for part in tiff.series if not part.keyframe.is_reduced]
    if not series:
        raise DataError(f"{path}: a TIFF without a picture")
    for part in series:
        _check(part, path)
    return series


def _check(part: Any, path: Path) -> None:
    """Refuse data that tifffile would fill with zeros: outside the file, or of missing pages."""
    page, size = part.keyframe, path.stat().st_size
    if page.photometric == tifffile.PHOTOMETRIC.PALETTE:
        raise DataError(f"{path}: a palette picture carries no radiometry. Export raw 16-bit data instead.")
    compressed = page.compression != tifffile.COMPRESSION.NONE
    check_size(path, part.nbytes, size, compressed=compressed, at_once=False)
    if part.dataoffset is not None:
        ends = [part.dataoffset + part.nbytes]
    else:
        ends = [
            offset + count
            for each in part.pages
            for offset, count in zip(each.dataoffsets, each.databytecounts, strict=True)
        ]
    if not ends or max(ends) > size:
        raise DataError(f"{path}: truncated: its data end beyond the end of the file")


def _nodata(part: Any) -> float | None:
    """The value of lost samples that GDAL's tag names, on whichever page."""
    tags = (page.tags.get(GDAL_NODATA) for page in part.pages if isinstance(page, tifffile.TiffPage))
    tag = next((tag for tag in tags if tag is not None), None)
    try:
        return None if tag is None else float(str(tag.value).strip("\0 "))
    except ValueError:
        return None


def _stack(pixels: Array, axes: str, path: Path, *, nodata: float | None = None) -> Array:
    """Frames (N, h, w) of the axes of a series; masked where samples are lost."""
    # Samples in separate planes are frames: the default of tifffile for a burst of three or four.
    if axes.endswith("S") and pixels.shape[-1] <= 4:  # more than colours and alpha: frames along the last axis
        pixels = to_grey(pixels, path)
    frames = pixels.reshape(-1, *pixels.shape[-2:])
    return frames if nodata is None else masked(frames, frames == nodata)
