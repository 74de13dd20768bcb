"""InfiRay's IJPEG, of P2 and others: in its APP3 segments a picture of 16 bits, then kelvin x 64.

Layout after https://github.com/exiftool/exiftool/issues/184.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from deepir.errors import DataError
from deepir.io.containers import jpeg
from deepir.io.radiometry import Linear, Radiometry
from deepir.io.readers import Array

SUFFIXES = (".jpg", ".jpeg")
APP2, APP3 = 0xE2, 0xE3  # markers of the segments with the name and with the planes
MARK = b"IJPEG"  # at byte 4 of the first APP2 segment
KELVIN = Linear(1 / 64)


def sniff(head: bytes, path: Path) -> bool:
    """A JPEG whose APP2 segment says so."""
    if not head.startswith(jpeg.JPEG_SIGNATURE):
        return False
    with path.open("rb") as file:
        return any(marker == APP2 and content[4:9] == MARK for marker, content in jpeg.segments(file))


def read(path: Path, key: str | None) -> Array:
    """The plane of temperatures (h, w), uint16, kelvin x 64.

    Raises:
        DataError: Its size does not go with that of the picture.
    """
    with path.open("rb") as file:
        planes = b"".join(content for marker, content in jpeg.segments(file) if marker == APP3)
    with path.open("rb") as file:
        shown = jpeg.picture_size(file)
    samples = len(planes) // 4  # of each of the two planes
    height = round(math.sqrt(samples * shown[0] / shown[1])) if shown else 0
    if not height or len(planes) % 4 or samples % height:
        raise DataError(
            f"{path}: damaged, or an IJPEG of a kind that is not known: {len(planes):,} bytes of planes"
        )
    return np.frombuffer(planes, "<u2", samples, 2 * samples).reshape(height, -1)


def radiometry(path: Path, key: str | None) -> Radiometry | None:
    """Kelvin x 64."""
    return KELVIN
