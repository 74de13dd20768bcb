"""Segments of JPEG files."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import IO

JPEG_SIGNATURE = b"\xff\xd8\xff"  # first bytes of a JPEG
SCAN_MARKER = 0xDA  # start of scan: the picture's data follow
FRAME_HEADER_MARKERS = {0xC0, 0xC1, 0xC2, 0xC3, 0xF7}  # SOF0 to SOF3 and, F7, SOF55 of JPEG-LS
END_OF_PICTURE = b"\xff\xd9"
#: APP3 to APP15 without those of HDR and signatures (APP11), Photoshop (APP13) and Adobe (APP14).
CAMERA_MARKERS = {*range(0xE3, 0xF0)} - {0xEB, 0xED, 0xEE}
APP2 = 0xE2
APP2_STANDARDS = (b"ICC_PROFILE\0", b"MPF\0", b"FPXR\0")  # first bytes of APP2 segments of standards
NEXT_MARKER = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]", re.DOTALL)  # within the data of a picture


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
