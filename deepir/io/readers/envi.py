"""ENVI: bare samples, and beside them a header of the same name that ends in .hdr. A band is a frame.

Keys after the public description of the header, https://www.nv5geospatialsoftware.com/docs/ENVIHeaderFiles.html.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from deepir.errors import DataError
from deepir.io.guards import check_size, masked, stream_planes
from deepir.io.readers import Array, Reader

HEADER_MARK = b"ENVI"  # first bytes of a header
SAMPLES_SUFFIXES = (".img", ".dat", ".bsq", ".bil", ".bip", ".raw", ".bin", "")
#: NumPy's types by ENVI's number of theirs.
TYPES = {1: "u1", 2: "i2", 3: "i4", 4: "f4", 5: "f8", 12: "u2", 13: "u4", 14: "i8", 15: "u8"}
#: Order of the axes in the file: bands (frames), lines and samples.
INTERLEAVES = {"bsq": "nhw", "bil": "hnw", "bip": "hwn"}
MAX_HEADER_BYTES = 2**20  # a header lists the wavelength of each band


class Envi(Reader):
    """Samples with a header beside them."""

    name = "envi"
    suffixes = (".hdr",)

    def sniff(self, head: bytes, path: Path) -> bool:
        """A header, or samples with one beside them."""
        return _header_of(path) is not None

    def stream(self, path: Path, key: str | None) -> Iterator[Array]:
        """Frame after frame (h, w) where they follow each other, else all at once."""
        samples, dtype, offset, shape, fields = _layout(path)
        if (axes := INTERLEAVES[fields["interleave"]]) != "nhw":
            check_size(path, size := math.prod(shape) * dtype.itemsize, size)
            stored = np.fromfile(samples, dtype, math.prod(shape), offset=offset).reshape(shape)
            yield _known(stored.transpose([axes.index(each) for each in "nhw"]), fields)
            return
        for frame in stream_planes(samples, dtype, offset, shape):
            yield _known(frame, fields)

    def samples_file(self, path: Path) -> Path:
        """The file of samples, also where its header was named."""
        return _layout(path)[0]


def _layout(path: Path) -> tuple[Path, np.dtype[Any], int, tuple[int, ...], dict[str, str]]:
    """The file of samples, their type, the bytes before them, their shape as stored, and the header's fields."""
    header = _header_of(path)
    assert header is not None
    text = header.read_bytes()[:MAX_HEADER_BYTES].decode(errors="replace")
    fields = {
        name.strip().lower(): value.strip()
        for name, value in re.findall(r"^([^=\n]+)=\s*(\{[^}]*\}|[^\n]*)", text, re.MULTILINE)
    }
    fields["interleave"] = fields.get("interleave", "bsq").lower()
    try:
        kind, order = TYPES[int(fields["data type"])], int(fields.get("byte order", 0))
        sides = {"h": int(fields["lines"]), "w": int(fields["samples"]), "n": int(fields.get("bands", 1))}
        shape = tuple(sides[each] for each in INTERLEAVES[fields["interleave"]])
    except (KeyError, ValueError) as error:
        raise DataError(
            f"{header}: no ENVI header of real numbers: it needs samples, lines, data type (of {sorted(TYPES)}) and "
            f"interleave (bsq, bil or bip); wrong or missing: {error}"
        ) from None
    if fields.get("file compression", "0") != "0":
        raise DataError(f"{header}: compressed ENVI samples are not read; export them without compression")
    samples, offset = _samples_of(path, header), int(fields.get("header offset", 0))
    dtype = np.dtype(kind).newbyteorder(">" if order else "<")
    declared, stored = math.prod(shape) * dtype.itemsize, samples.stat().st_size - offset
    if not 0 < declared <= stored:
        raise DataError(
            f"{samples}: damaged or truncated: {stored:,} bytes of samples where {header.name} says {declared:,}"
        )
    return samples, dtype, offset, shape, fields


def _header_of(path: Path) -> Path | None:
    """The header of a file, or the file itself where it is one."""
    if not path.is_file():
        return None
    names = {".hdr": (path,)}.get(path.suffix.lower(), (path.with_suffix(".hdr"), Path(f"{path}.hdr")))
    for name in names if path.suffix.lower() in (".hdr", *SAMPLES_SUFFIXES) else ():
        if name.is_file():
            with name.open("rb") as file:
                if file.read(len(HEADER_MARK)) == HEADER_MARK:
                    return name
    return None


def _samples_of(path: Path, header: Path) -> Path:
    """The file of samples of a header, where not that itself was named."""
    if path != header:
        return path
    bare = header.with_suffix("")
    for name in (bare, *(bare.with_suffix(suffix) for suffix in SAMPLES_SUFFIXES)):
        if name.is_file():
            return name
    raise DataError(f"{header}: its samples are missing: {bare}, or the same with {', '.join(SAMPLES_SUFFIXES[:-1])}")


def _known(frames: Array, fields: dict[str, str]) -> Array:
    """Masked where samples hold the value that the header names for lost ones."""
    value = fields.get("data ignore value")
    return masked(frames, frames == float(value)) if value else frames
