"""TIFF of one or many pages, 8 to 64 bit, integer or float, in any compression that imagecodecs knows."""

from __future__ import annotations

import json
import logging
import math
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import tifffile

from deepir.config import schema
from deepir.errors import ConfigError, DataError
from deepir.io.guards import FileBytes, check_size, masked, stream_planes, to_grey
from deepir.io.radiometry import KELVIN, Radiometry, resolve_radiometry
from deepir.io.readers import Array, Reader

GDAL_NODATA = 42113  # the tag of the value of lost samples, a text
SUBDIRECTORIES = 330  # the tag SubIFDs
OFFSET_FORMATS = {4: "I", 13: "I", 16: "Q", 17: "Q", 18: "Q"}  # of the types LONG, IFD, LONG8, SLONG8, IFD8
PALETTE_PHOTOMETRIC = 3  # PhotometricInterpretation of a palette picture

# Python prints messages of a library's logger that nobody handles; ours become errors instead.
logging.getLogger("tifffile").addHandler(logging.NullHandler())


class Tiff(Reader):
    """TIFF and BigTIFF, in either byte order."""

    name = "tiff"
    suffixes = (".tif", ".tiff")
    signatures = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
    any_axes = True

    def read(self, path: Path, key: str | None) -> Array:
        """All pages of full size, (N, h, w).

        Raises:
            DataError: Pages differ in size, lie outside the file, or are in colour.
        """
        with _open(path) as tiff:
            series = _series(tiff, path)
            check_size(path, sum(p.nbytes for p in series), path.stat().st_size, compressed=True)
            stacks = [_stack(part.asarray(), part.axes, path, nodata=_nodata(part)) for part in series]
        sizes = {stack.shape[1:] for stack in stacks}
        if len(sizes) > 1:
            raise DataError(f"{path}: its pages differ in size: {' and '.join(map(str, sorted(sizes)))}")
        return np.ma.concatenate(stacks) if len(stacks) > 1 else stacks[0]

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

    def radiometry(self, path: Path, key: str | None) -> Radiometry | None:
        """Radiometry that deepir wrote into the description, see `deepir.io.radiometry.unit_metadata`."""
        with _open(path) as tiff:
            try:
                description = json.loads(tiff.pages.first.description)
                if description.get("unit") == "K":
                    return KELVIN
                return resolve_radiometry(None, schema.Radiometry(**description["radiometry"]))
            except (ValueError, TypeError, KeyError, AttributeError, ConfigError):  # anybody else's description
                return None


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
    """Number of the directories of a TIFF or BigTIFF, without sub-directories.

    Raises:
        DataError: One is reached twice, or lies outside the file. What else is wrong is left to the library that reads.
    """
    with FileBytes(path) as data:
        order = "<" if data[:2] == b"II" else ">"
        large = struct.unpack(f"{order}H", data[2:4])[0] == 43
        offset, count, entry, width = ("Q", "Q", "HHQ8s", 8) if large else ("I", "H", "HHI4s", 4)
        first = data[width : 2 * width]
        waiting, seen, found = [(*struct.unpack(order + offset, first), True)], set[int](), 0
        while waiting:
            at, is_main = waiting.pop()
            if not at:  # the end of a chain
                continue
            if at in seen:
                raise DataError(f"{path}: damaged: its directory at byte {at} is reached twice")
            seen.add(at)
            found += is_main
            start = at + struct.calcsize(order + count)
            (entries,) = struct.unpack(order + count, data[at:start])
            size = entries * struct.calcsize(order + entry)
            if start + size + width > len(data):
                raise DataError(f"{path}: truncated: its directory at byte {at} lies outside the file")
            for tag, kind, length, value in struct.iter_unpack(order + entry, data[start : start + size]):
                if tag == SUBDIRECTORIES and kind in OFFSET_FORMATS:
                    below = f"{order}{length}{OFFSET_FORMATS[kind]}"
                    stored = struct.calcsize(below)
                    offsets = value[:stored]
                    if stored > width:  # in their place is that of their list
                        (place,) = struct.unpack(order + offset, value)
                        if place + stored > len(data):
                            raise DataError(f"{path}: truncated: its list of directories lies outside the file")
                        offsets = data[place : place + stored]
                    waiting += [(sub, False) for sub in struct.unpack(below, offsets)]
            following = data[start + size : start + size + width]
            waiting.append((*struct.unpack(order + offset, following), is_main))
        return found


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
    if page.photometric == PALETTE_PHOTOMETRIC:
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
