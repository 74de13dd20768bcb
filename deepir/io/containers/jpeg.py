"""Segments before a JPEG's picture, in which thermal cameras store their raw plane."""

from __future__ import annotations

from collections.abc import Iterator
from typing import IO

JPEG_SIGNATURE = b"\xff\xd8\xff"  # first bytes of a JPEG
SCAN_MARKER = 0xDA  # start of scan: the picture's data follow
FRAME_HEADER_MARKERS = {0xC0, 0xC1, 0xC2, 0xC3, 0xF7}  # SOF0 to SOF3 and, F7, SOF55 of JPEG-LS


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


def picture_size(stream: IO[bytes]) -> tuple[int, int] | None:
    """Height and width of the picture; None if the file does not contain them."""
    for marker, content in segments(stream):
        if marker in FRAME_HEADER_MARKERS:
            return int.from_bytes(content[1:3]), int.from_bytes(content[3:5])
    return None
