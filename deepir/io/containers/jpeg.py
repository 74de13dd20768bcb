"""Segments of JPEG files, and directories of TIFF files."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from deepir.errors import DataError
from deepir.io.containers.file_bytes import FileBytes

SUBDIRECTORIES = 330  # the tag SubIFDs
#: Bytes of a value of the types that an offset has: LONG, IFD, LONG8, SLONG8, IFD8.
VALUE_BYTES = {4: 4, 13: 4, 16: 8, 17: 8, 18: 8}
JPEG_SIGNATURE = b"\xff\xd8\xff"  # first bytes of a JPEG
SCAN_MARKER = 0xDA  # start of scan: the picture's data follow
FRAME_HEADER_MARKERS = {0xC0, 0xC1, 0xC2, 0xC3, 0xF7}  # SOF0 to SOF3 and, F7, SOF55 of JPEG-LS
END_OF_PICTURE = b"\xff\xd9"
#: APP3 to APP15 without those of HDR and signatures (APP11), Photoshop (APP13) and Adobe (APP14).
CAMERA_MARKERS = {*range(0xE3, 0xF0)} - {0xEB, 0xED, 0xEE}
APP2 = 0xE2
APP2_STANDARDS = (b"ICC_PROFILE\0", b"MPF\0", b"FPXR\0")  # first bytes of APP2 segments of standards
NEXT_MARKER = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]", re.DOTALL)  # within the data of a picture


def count_directories(path: Path) -> int:
    """Number of the directories of a TIFF or BigTIFF, without sub-directories.

    Raises:
        DataError: One is reached twice, or lies outside the file. What else is wrong is left to the library that reads.
    """
    with FileBytes(path) as data:
        order = "<" if data[:2] == b"II" else ">"
        large = struct.unpack(f"{order}H", data[2:4])[0] == 43
        offset, count, entry = ("Q", "Q", "HHQQ") if large else ("I", "H", "HHII")
        first = data[8:16] if large else data[4:8]
        waiting, seen, found = [(*struct.unpack(order + offset, first), True)], set[int](), 0
        while waiting:
            at, is_main = waiting.pop()
            if not at:  # the end of a chain
                continue
            if at in seen:
                raise DataError(f"{path}: damaged: its directory at byte {at} is reached twice")
            seen.add(at)
            found += is_main
            start = at + struct.calcsize(order + count)
            (entries,) = struct.unpack(order + count, data[at:start])
            size = struct.calcsize(order + entry)
            end = start + entries * size + struct.calcsize(order + offset)
            if end > len(data):
                raise DataError(f"{path}: truncated: its directory at byte {at} lies outside the file")
            table = data[start:end]
            for tag, kind, length, value in struct.iter_unpack(order + entry, table[: entries * size]):
                if tag == SUBDIRECTORIES and kind in VALUE_BYTES:
                    waiting += [
                        (sub, False) for sub in _offsets(data, order, kind, length, value, large=large)
                    ]
            waiting.append((*struct.unpack(order + offset, table[entries * size :]), is_main))
        return found


def _offsets(data: FileBytes, order: str, kind: int, length: int, value: int, *, large: bool) -> list[int]:
    """The offsets of sub-directories; a single one stands in place of where they are."""
    each = VALUE_BYTES[kind]
    if length == 1 and each == (8 if large else 4):
        return [value]
    if length * each <= (8 if large else 4):  # several that are packed into the entry: no writer does that
        return []
    if value + length * each > len(data):
        raise DataError(f"{data.path}: truncated: its list of directories lies outside the file")
    return list(
        struct.unpack(f"{order}{length}{'I' if each == 4 else 'Q'}", data[value : value + length * each])
    )


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
