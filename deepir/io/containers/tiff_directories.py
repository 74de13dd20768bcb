"""The directories of a TIFF, walked before a library follows them: one that names itself would never end."""

from __future__ import annotations

import struct
from pathlib import Path

from deepir.errors import DataError
from deepir.io.containers.file_bytes import FileBytes

SUBDIRECTORIES = 330  # the tag SubIFDs
#: Bytes of a value of the types that an offset has: LONG, IFD, LONG8, SLONG8, IFD8.
VALUE_BYTES = {4: 4, 13: 4, 16: 8, 17: 8, 18: 8}


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
