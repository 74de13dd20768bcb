"""DJI's R-JPEG: the raw plane in its APP3 segments. Its radiometry is in DJI's own SDK only."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from deepir.errors import DataError
from deepir.io.containers import jpeg
from deepir.io.readers import Array
from deepir.io.readers.thermal import infiray_jpeg

SUFFIXES = (".jpg", ".jpeg")
APP3 = 0xE3  # marker of the segments with the raw plane
MIN_PLANE_BYTES = 160 * 120 * 2  # length of the smallest raw plane
DETECTOR_SHAPES = ((512, 640), (1024, 1280), (256, 320), (120, 160))  # (h, w) of DJI's detectors, px


def sniff(head: bytes, path: Path) -> bool:
    """A JPEG with APP3 segments as large as a picture, and not InfiRay's."""
    return (
        head.startswith(jpeg.JPEG_SIGNATURE)
        and len(_plane(path)) >= MIN_PLANE_BYTES
        and not infiray_jpeg.sniff(head, path)
    )


def read(path: Path, key: str | None) -> Array:
    """The raw plane (h, w), uint16 counts.

    Raises:
        DataError: Its size fits no detector.
    """
    data = _plane(path)
    with path.open("rb") as file:
        shown = jpeg.picture_size(file) or DETECTOR_SHAPES[0]
    for height, width in (shown, *DETECTOR_SHAPES):
        if len(data) == 2 * height * width:
            return np.frombuffer(data, "<u2").reshape(height, width)
    raise DataError(
        f"{path}: damaged or truncated: {len(data):,} bytes of raw plane fit no detector of DJI's"
    )


def _plane(path: Path) -> bytes:
    with path.open("rb") as file:
        return b"".join(content for marker, content in jpeg.segments(file) if marker == APP3)
