"""JPEGs of DJI and InfiRay with raw planes in their APP3 segments."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from deepir.errors import DataError
from deepir.io.containers import jpeg
from deepir.io.radiometry import Linear, Radiometry
from deepir.io.readers import Array, Reader

APP2, APP3 = 0xE2, 0xE3  # markers of the segments with InfiRay's name and with the planes
IJPEG_MARK = b"IJPEG"  # at byte 4 of InfiRay's first APP2 segment
MIN_PLANE_BYTES = 160 * 120 * 2  # length of DJI's smallest raw plane
DETECTOR_SHAPES = ((512, 640), (1024, 1280), (256, 320), (120, 160))  # (h, w) of DJI's detectors, px


class DjiJpeg(Reader):
    """DJI's R-JPEG. Its radiometry is in DJI's own SDK only."""

    name = "dji_jpeg"
    suffixes = (".jpg", ".jpeg")
    holds_raw_plane = True

    def sniff(self, head: bytes, path: Path) -> bool:
        """A JPEG with APP3 segments as large as a picture, and not InfiRay's."""
        is_large = head.startswith(jpeg.JPEG_SIGNATURE) and len(_planes(path)) >= MIN_PLANE_BYTES
        return is_large and not _is_infiray(path)

    def read(self, path: Path, key: str | None) -> Array:
        """The raw plane (h, w), uint16 counts.

        Raises:
            DataError: Its size fits no detector.
        """
        data = _planes(path)
        for height, width in (_shown(path) or DETECTOR_SHAPES[0], *DETECTOR_SHAPES):
            if len(data) == 2 * height * width:
                return np.frombuffer(data, "<u2").reshape(height, width)
        raise DataError(
            f"{path}: damaged or truncated: {len(data):,} bytes of raw plane fit no detector of DJI's"
        )


class InfirayJpeg(Reader):
    """InfiRay's IJPEG, of P2 and others: a picture of 16 bits, then kelvin x 64.

    Layout after https://github.com/exiftool/exiftool/issues/184.
    """

    name = "infiray_jpeg"
    suffixes = (".jpg", ".jpeg")
    holds_raw_plane = True

    def sniff(self, head: bytes, path: Path) -> bool:
        """A JPEG whose APP2 segment says so."""
        return head.startswith(jpeg.JPEG_SIGNATURE) and _is_infiray(path)

    def read(self, path: Path, key: str | None) -> Array:
        """The plane of temperatures (h, w), uint16, kelvin x 64.

        Raises:
            DataError: Its size does not go with that of the picture.
        """
        planes, shown = _planes(path), _shown(path)
        samples = len(planes) // 4  # of each of the two planes
        height = round(math.sqrt(samples * shown[0] / shown[1])) if shown else 0
        if not height or len(planes) % 4 or samples % height:
            raise DataError(
                f"{path}: damaged, or an IJPEG of a kind that is not known: {len(planes):,} bytes of planes"
            )
        return np.frombuffer(planes, "<u2", samples, 2 * samples).reshape(height, -1)

    def radiometry(self, path: Path, key: str | None) -> Radiometry | None:
        """Kelvin x 64."""
        return Linear(1 / 64)


def _planes(path: Path) -> bytes:
    return b"".join(jpeg.contents(path, APP3))


def _is_infiray(path: Path) -> bool:
    return any(content[4:9] == IJPEG_MARK for content in jpeg.contents(path, APP2))


def _shown(path: Path) -> tuple[int, int] | None:
    """Height and width of the picture that is shown."""
    with path.open("rb") as file:
        return jpeg.picture_size(file)
