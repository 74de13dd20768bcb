"""The segments before a JPEG's picture, where thermal cameras keep their raw plane."""

from __future__ import annotations

from collections.abc import Iterator
from typing import IO

JPEG_SIGNATURE = b"\xff\xd8\xff"  # first bytes of a JPEG
SCAN_MARKER = 0xDA  # start of scan: the picture's data follow
FRAME_HEADER_MARKERS = {0xC0, 0xC1, 0xC2, 0xC3, 0xF7}  # SOF0 to SOF3 and, F7, SOF55 of JPEG-LS


def segments(stream: IO[bytes]) -> Iterator[tuple[int, bytes]]:
    """Marker (its second byte: 0xE1 is APP1) and content of each segment up to the picture's data.

    `stream` is at its beginning. Ends early where the file does, or where no segment begins.
    """
    stream.seek(2)
    while len(head := stream.read(4)) == 4 and head[0] == 0xFF and head[1] != SCAN_MARKER:
        yield head[1], stream.read(max(0, int.from_bytes(head[2:]) - 2))


def picture_size(stream: IO[bytes]) -> tuple[int, int] | None:
    """(h, w) of the picture; None if the file does not say."""
    for marker, content in segments(stream):
        if marker in FRAME_HEADER_MARKERS:
            return int.from_bytes(content[1:3]), int.from_bytes(content[3:5])
    return None
