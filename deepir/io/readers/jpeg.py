"""Segments of JPEG files, and the JPEGs of DJI and InfiRay with raw planes in theirs."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import numpy as np

from deepir.errors import DataError
from deepir.io.radiometry import Linear, Radiometry
from deepir.io.readers import Array, Reader

JPEG_SIGNATURE = b"\xff\xd8\xff"  # first bytes of a JPEG
SCAN_MARKER = 0xDA  # start of scan: the picture's data follow
FRAME_HEADER_MARKERS = {0xC0, 0xC1, 0xC2, 0xC3, 0xF7}  # SOF0 to SOF3 and, F7, SOF55 of JPEG-LS
END_OF_PICTURE = b"\xff\xd9"
#: APP3 to APP15 without those of HDR and signatures (APP11), Photoshop (APP13) and Adobe (APP14).
CAMERA_MARKERS = {*range(0xE3, 0xF0)} - {0xEB, 0xED, 0xEE}
APP2_STANDARDS = (b"ICC_PROFILE\0", b"MPF\0", b"FPXR\0")  # first bytes of APP2 segments of standards
NEXT_MARKER = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]", re.DOTALL)  # within the data of a picture
APP2, APP3 = 0xE2, 0xE3  # markers of the segments with InfiRay's name and with the planes
IJPEG_MARK = b"IJPEG"  # at byte 4 of InfiRay's first APP2 segment
MIN_PLANE_BYTES = 160 * 120 * 2  # length of DJI's smallest raw plane
DETECTOR_SHAPES = ((512, 640), (1024, 1280), (256, 320), (120, 160))  # (h, w) of DJI's detectors, px


def segments(stream: IO[bytes]) -> Iterator[tuple[int, bytes]]:
    """Segments of a JPEG up to the picture's data.

    Ends early where the file ends, or where no segment begins.

    Args:
        stream: At its beginning.

    Yields:
        Marker (its second byte: 0xE1 is APP1) and content.
    """
    stream.seek(2)
    while len(head := stream.read(4)) == 4 and head[0] == 0xFF and head[1] != SCAN_MARKER:
        yield head[1], stream.read(max(0, int.from_bytes(head[2:]) - 2))


def contents(path: Path, marker: int) -> list[bytes]:
    """Contents of the segments of a JPEG file that have this marker."""
    with path.open("rb") as file:
        return [content for found, content in segments(file) if found == marker]


def picture_size(stream: IO[bytes]) -> tuple[int, int] | None:
    """Height and width of the picture; None if the file does not contain them."""
    for marker, content in segments(stream):
        if marker in FRAME_HEADER_MARKERS:
            return int.from_bytes(content[1:3]), int.from_bytes(content[3:5])
    return None


def camera_data(stream: IO[bytes]) -> dict[str, int]:
    """Bytes that a camera has stored beside the picture in ways of its own, by their place: `{"APP4": 655360}`."""
    found: dict[str, int] = {}
    several = False
    for marker, content in segments(stream):
        own = marker == APP2 and not content.startswith(APP2_STANDARDS)
        several |= content.startswith(b"MPF\0")  # further pictures follow the first
        if marker in CAMERA_MARKERS or own:
            name = f"APP{marker - 0xE0}"
            found[name] = found.get(name, 0) + len(content)
    after = b"" if several else _after_picture(stream)
    return found if after.startswith(JPEG_SIGNATURE) else found | {"after the picture": len(after)}


def _after_picture(stream: IO[bytes]) -> bytes:
    """What follows the end of the first picture, from the start of whose data `segments` has stopped."""
    data, at = stream.read(), 0
    while (marker := NEXT_MARKER.search(data, at)) is not None:
        at = marker.end()
        if marker[0] == END_OF_PICTURE:
            return data[at:]
        at += int.from_bytes(data[at : at + 2])
    return b""


class DjiJpeg(Reader):
    """DJI's R-JPEG. Its radiometry is in DJI's own SDK only."""

    name = "dji_jpeg"
    suffixes = (".jpg", ".jpeg")
    holds_raw_plane = True

    def sniff(self, head: bytes, path: Path) -> bool:
        """A JPEG with APP3 segments as large as a picture, and not InfiRay's."""
        is_large = head.startswith(JPEG_SIGNATURE) and len(_planes(path)) >= MIN_PLANE_BYTES
        return is_large and not _is_infiray(path)

    def read(self, path: Path, key: str | None) -> Array:
        """The raw plane (h, w), uint16 counts."""
        data = _planes(path)
        for height, width in (_shown(path) or DETECTOR_SHAPES[0], *DETECTOR_SHAPES):
            if len(data) == 2 * height * width:
                return np.frombuffer(data, "<u2").reshape(height, width)
        raise DataError(f"{path}: damaged or truncated: {len(data):,} bytes of raw plane fit no detector of DJI's")


class InfirayJpeg(Reader):
    """InfiRay's IJPEG, of P2 and others: a picture of 16 bits, then kelvin x 64.

    Layout after https://github.com/exiftool/exiftool/issues/184.
    """

    name = "infiray_jpeg"
    suffixes = (".jpg", ".jpeg")
    holds_raw_plane = True

    def sniff(self, head: bytes, path: Path) -> bool:
        """A JPEG whose APP2 segment says so."""
        return head.startswith(JPEG_SIGNATURE) and _is_infiray(path)

    def read(self, path: Path, key: str | None) -> Array:
        """The plane of temperatures (h, w), uint16, kelvin x 64."""
        planes, shown = _planes(path), _shown(path)
        samples = len(planes) // 4  # of each of the two planes
        height = round(math.sqrt(samples * shown[0] / shown[1])) if shown else 0
        if not height or len(planes) % 4 or samples % height:
            raise DataError(
                f"{path}: damaged, or an IJPEG of a kind that is not known: {len(planes):,} bytes of planes"
            )
        return np.frombuffer(planes, "<u2", samples, 2 * samples).reshape(height, -1)

    def radiometries(self, path: Path, key: str | None) -> list[Radiometry | None]:
        """Kelvin x 64."""
        return [Linear(1 / 64)]


def _planes(path: Path) -> bytes:
    return b"".join(contents(path, APP3))


def _is_infiray(path: Path) -> bool:
    return any(content[4:9] == IJPEG_MARK for content in contents(path, APP2))


def _shown(path: Path) -> tuple[int, int] | None:
    """Height and width of the picture that is shown."""
    with path.open("rb") as file:
        return picture_size(file)
