"""CPTV, the Cacophony Project's thermal video: Lepton frames as packed differences, in one gzip.

Source: the public specification, https://github.com/TheCacophonyProject/go-cptv/blob/master/SPEC.md.
"""

from __future__ import annotations

import functools
import gzip
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from deepir.errors import DataError
from deepir.io.guards import check_size
from deepir.io.readers import Array, Reader

CPTV_MAGIC = b"CPTV"  # first bytes of the unpacked stream
MAX_DIFFERENCE_BITS = 24  # bits of a difference

Fields = dict[bytes, bytes]
_number = functools.partial(int.from_bytes, byteorder="little")


class Cptv(Reader):
    """CPTV of version 1 or 2."""

    name = "cptv"
    suffixes = (".cptv",)
    holds_raw_plane = True

    def sniff(self, head: bytes, path: Path) -> bool:
        """A gzip of a CPTV stream."""
        if not head.startswith(b"\x1f\x8b"):
            return False
        try:
            with gzip.open(path) as file:
                return file.read(4) == CPTV_MAGIC
        except (OSError, EOFError):
            return False

    def stream(self, path: Path, key: str | None) -> Iterator[Array]:
        """Frame after frame (h, w), without the camera's background picture."""
        with gzip.open(path) as file:
            if file.read(4) != CPTV_MAGIC or file.read(1) not in (b"\1", b"\2"):
                raise DataError(f"{path}: not a CPTV of version 1 or 2")
            header = _fields(file, b"H", path)
            width, height = _number(header[b"X"]), _number(header[b"Y"])
            check_size(path, 4 * width * height, path.stat().st_size, compressed=True)
            last = np.zeros(height * width, np.int64)
            while file.peek(1):
                about = _fields(file, b"F", path)
                packed = _exactly(file, _number(about[b"f"]), path)
                last += np.cumsum(_differences(packed, _number(about[b"w"]), last.size, path))
                if not _number(about.get(b"g", b"\0")):
                    frame = last.reshape(height, width).astype(np.uint16)
                    frame[1::2] = frame[1::2, ::-1]  # rows are stored in alternating directions
                    yield frame


def _fields(file: gzip.GzipFile, kind: bytes, path: Path) -> Fields:
    """Fields of a section by their letter."""
    if (found := file.read(1)) != kind:
        raise DataError(f"{path}: damaged: a section {found!r} where {kind!r} is due")
    fields = {}
    for _ in range(_exactly(file, 1, path)[0]):
        length, letter = _exactly(file, 1, path)[0], _exactly(file, 1, path)
        fields[letter] = _exactly(file, length, path)
    return fields


def _exactly(file: gzip.GzipFile, count: int, path: Path) -> bytes:
    check_size(path, count, path.stat().st_size, compressed=True)
    data = file.read(count)
    if len(data) != count:
        raise DataError(f"{path}: truncated: it ends within a frame")
    return data


def _differences(packed: bytes, bits: int, count: int, path: Path) -> Array:
    """The first value and `count` - 1 signed differences of `bits` bits, most significant bit first."""
    if not 0 < bits <= MAX_DIFFERENCE_BITS or len(packed) < 4 + ((count - 1) * bits + 7) // 8:
        raise DataError(f"{path}: damaged: {len(packed)} bytes for {count} pixels of {bits} bits")
    digits = np.unpackbits(np.frombuffer(packed, np.uint8, offset=4), count=(count - 1) * bits)
    weights = 1 << np.arange(bits - 1, -1, -1, dtype=np.int64)
    weights[0] *= -1  # two's complement
    return np.concatenate([struct.unpack_from("<i", packed), digits.reshape(-1, bits) @ weights])
