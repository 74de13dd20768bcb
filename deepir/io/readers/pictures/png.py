"""PNG, 8 and 16 bit. libpng keeps all 16 bits of a colour picture, where Pillow keeps 8."""

from __future__ import annotations

import struct
from pathlib import Path

import imagecodecs

from deepir.io.guards import check_size, to_grey
from deepir.io.readers import Array

SUFFIXES = (".png",)
CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # samples per pixel by PNG's colour type


def sniff(head: bytes, path: Path) -> bool:
    """PNG's signature."""
    return head.startswith(b"\x89PNG\r\n\x1a\n")


def read(path: Path, key: str | None) -> Array:
    """The picture (h, w), uint8 or uint16.

    Raises:
        DataError: It is in colour.
    """
    pixels = decode(path.read_bytes(), path)
    return pixels if pixels.ndim == 2 else to_grey(pixels, path)


def decode(data: bytes, path: Path) -> Array:
    """Pixels of a PNG, (h, w) or (h, w, C); `path` is for messages."""
    width, height, depth, colour = struct.unpack(">IIBB", data[16:26])
    check_size(path, width * height * CHANNELS[colour] * depth // 8, len(data), compressed=True)
    pixels: Array = imagecodecs.png_decode(data)
    return pixels
