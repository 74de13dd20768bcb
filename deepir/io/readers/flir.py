"""FLIR's radiometric JPEG, and its recordings SEQ and CSQ: records of an FFF, one for each frame.

Layout and names after the public description by P. Harvey, https://exiftool.org/TagNames/FLIR.html.
"""

from __future__ import annotations

import io
import math
import struct
from collections.abc import Iterator
from pathlib import Path

import imagecodecs
import numpy as np

from deepir.errors import DataError
from deepir.io.guards import FileBytes, check_size, warn_once
from deepir.io.inspection.samples import mean_step
from deepir.io.radiometry import Planck, Radiometry, air_transmission
from deepir.io.readers import Array, Reader, jpeg
from deepir.io.readers.pictures import decode_png

APP1 = 0xE1  # marker of the segments of a JPEG with FLIR's records
FLIR_MARK = b"FLIR\0"  # first bytes of such a segment
FFF_MAGIC = b"FFF\0"  # first bytes of an FFF
AFF_MAGIC = b"AFF\0"  # first bytes of an older kind of SEQ, with other records
RAW_RECORD = 1  # kind of the record with the raw plane
CAMERA_RECORD = 32  # kind of the record with calibration and settings
HEADER_BYTES = 64  # length of the file header
ENTRY_BYTES = 32  # length of an entry of the directory
PIXELS_OFFSET = 32  # bytes before the pixels of a raw plane
MISSING_PADDING = 4  # bytes that the last record of a recording may be short of: they hold no pixels
CAMERA_RECORD_BYTES = 0x310  # least length of a camera record
MAX_RECORDS = 1000  # records of a directory; more mean damage
#: Byte offsets of the user's settings in the camera record.
SETTING_OFFSETS = {
    "emissivity": 0x20,
    "reflected": 0x28,
    "atmosphere": 0x2C,
    "window": 0x30,
    "window_transmission": 0x34,
}

Records = dict[int, bytes]


class FlirJpeg(Reader):
    """FLIR's radiometric JPEG: the raw counts beside the coloured picture."""

    name = "flir_jpeg"
    suffixes = (".jpg", ".jpeg")
    holds_raw_plane = True

    def sniff(self, head: bytes, path: Path) -> bool:
        """A JPEG with a segment of FLIR's."""
        return head.startswith(jpeg.JPEG_SIGNATURE) and bool(_parts(path))

    def read(self, path: Path, key: str | None) -> Array:
        """The raw plane (h, w), uint16 counts."""
        return read_raw_plane(_joined_records(path), path)

    def radiometries(self, path: Path, key: str | None) -> list[Radiometry | None]:
        """Planck's law with the camera's constants and the user's settings: emissivity, distance ..."""
        return [read_radiometry(_joined_records(path))]


class FlirSequence(Reader):
    """FLIR's recordings: one FFF for each frame, raw in SEQ and packed as JPEG-LS in CSQ."""

    name = "flir_sequence"
    suffixes = (".seq", ".csq", ".fff")
    signatures = (FFF_MAGIC, AFF_MAGIC)  # the latter is refused by name
    holds_raw_plane = True

    def stream(self, path: Path, key: str | None) -> Iterator[Array]:
        """Frame after frame (h, w); of a recording whose last frame is cut off, the whole ones, with a warning."""
        with FileBytes(path) as data:
            if data[:4] == AFF_MAGIC:
                raise DataError(
                    f"{path}: FLIR's older SEQ (AFF), which is not read; export it as CSQ, TIFF or radiometric JPEG "
                    "with FLIR's software"
                )
            start, count = 0, 0
            while start != -1:
                try:
                    found, end = read_records(data, path, start)
                    plane = read_raw_plane(found, path)
                except Exception:
                    if not count or data.find(FFF_MAGIC, start + len(FFF_MAGIC)) != -1:
                        raise
                    warn_once(f"{path}: its last frame is cut off; the {count} whole ones are read")
                    return
                yield plane
                count += 1
                start = data.find(FFF_MAGIC, end)

    def radiometries(self, path: Path, key: str | None) -> list[Radiometry | None]:
        """Radiometry of each frame: emissivity, distance or the camera's range may change while it records."""
        laws: list[Radiometry | None] = []
        with FileBytes(path) as data:
            start = 0
            while start != -1:
                try:
                    found, end = read_records(data, path, start, (CAMERA_RECORD,))
                except Exception:  # where `stream` ends, or says what is wrong
                    break
                laws.append(read_radiometry(found))
                start = data.find(FFF_MAGIC, end)
        return laws or [None]


def _joined_records(path: Path) -> Records:
    """FLIR's records, joined from the numbered segments of a JPEG."""
    parts = _parts(path)
    numbers = [part[6] for part in parts]
    if numbers != list(range(parts[0][7] + 1)):
        raise DataError(f"{path}: damaged or truncated: of FLIR's {parts[0][7] + 1} segments it has {len(parts)}")
    return read_records(b"".join(part[8:] for part in parts), path)[0]


def _parts(path: Path) -> list[bytes]:
    return [part for part in jpeg.contents(path, APP1) if part.startswith(FLIR_MARK) and len(part) >= 8]


def read_records(
    data: bytes | FileBytes, path: Path, start: int = 0, kinds: tuple[int, ...] = (RAW_RECORD, CAMERA_RECORD)
) -> tuple[Records, int]:
    """Records of an FFF.

    Args:
        data: The bytes.
        path: The file, for messages.
        start: First byte of the FFF.
        kinds: Of the records that are read.

    Returns:
        The records by their kind, and the first byte after the FFF.

    Raises:
        DataError: The directory or a record lies outside the data, the padding of the last one aside.
    """
    order = ">" if data[start + 20 : start + 22] == b"\0\0" else "<"
    directory, count = struct.unpack(f"{order}II", data[start + 24 : start + 32])
    directory += start
    end = max(start + HEADER_BYTES, directory + ENTRY_BYTES * count)
    if count > MAX_RECORDS or end > len(data):
        raise DataError(f"{path}: truncated: FLIR's directory of {count} records lies outside the file")
    entries = data[directory : directory + ENTRY_BYTES * count]
    found: Records = {}
    for k in range(count):
        kind, _, _, _, offset, length = struct.unpack_from(f"{order}HHIIII", entries, ENTRY_BYTES * k)
        first, after = start + offset, start + offset + length
        if kind and after > len(data) + MISSING_PADDING:
            raise DataError(f"{path}: truncated: a record of FLIR's ends beyond the end of the file")
        if kind in kinds:
            found.setdefault(kind, data[first:after])
        if kind:
            end = max(end, after)
    return found, end


def read_raw_plane(found: Records, path: Path) -> Array:
    """The raw counts (h, w), uint16: plain, or packed as PNG or JPEG-LS.

    Raises:
        DataError: There are none, or their size differs from the record's.
    """
    if RAW_RECORD not in found:
        raise DataError(f"{path}: FLIR's records hold no raw plane; export a radiometric file")
    record = found[RAW_RECORD]
    order = byte_order(record)
    width, height = struct.unpack_from(f"{order}HH", record, 2)
    packed = record[PIXELS_OFFSET:]
    if packed.startswith(b"\x89PNG"):
        # Most cameras write little-endian counts, against the standard, some do not: the smoother order. The median in
        # the record does not say which: on some it is a level that the user has set.
        counts = decode_png(packed, path)
        plane = min((counts.byteswap(), counts), key=mean_step)
    elif packed.startswith(jpeg.JPEG_SIGNATURE):
        plane = _jpeg_ls(packed, path)
    else:
        check_size(path, 2 * width * height, len(packed))
        plane = np.frombuffer(packed, f"{order}u2", width * height).reshape(height, width).astype(np.uint16)
    if plane.shape != (height, width) or plane.dtype != np.uint16:
        raise DataError(f"{path}: damaged: its raw plane is {plane.shape}, its record says {(height, width)}")
    return plane


def read_radiometry(found: Records) -> Planck | None:
    """Radiometry of the camera and the settings of its user; None if they are missing or impossible."""
    record = found.get(CAMERA_RECORD, b"")
    if len(record) < CAMERA_RECORD_BYTES:
        return None
    order = byte_order(record)

    def number(at: int, kind: str = "f") -> float:
        value = struct.unpack_from(f"{order}{kind}", record, at)[0]
        return round(value, 9) if math.isfinite(value) else 0.0

    r1, b, r2, humidity = number(0x58), number(0x5C), number(0x30C), number(0x3C)
    setting = {name: number(at) for name, at in SETTING_OFFSETS.items()}
    try:
        through = air_transmission(
            number(0x24),
            humidity / 100 if humidity > 2 else humidity,
            setting["atmosphere"],
            (number(0x70), number(0x74)),
            (number(0x78), number(0x7C)),
            number(0x80),
        )
    except (ValueError, OverflowError):  # a root or a power of nonsense
        return None
    fractions = (setting["emissivity"], setting["window_transmission"], through)
    if min(r1, b, r2, *setting.values(), through) <= 0 or max(fractions) > 1:
        return None
    return Planck(r1, b, number(0x60), number(0x308, "i"), r2, transmission=through, **setting)


def byte_order(record: bytes) -> str:
    """Byte order of a record, which begins with the number 2."""
    return "<" if record[:2] == b"\2\0" else ">"


def _jpeg_ls(packed: bytes, path: Path) -> Array:
    if packed.rfind(jpeg.END_OF_PICTURE) < 0:  # the decoder would take seconds to find that out
        raise DataError(f"{path}: truncated: a packed raw plane has no end")
    height, width = jpeg.picture_size(io.BytesIO(packed)) or (0, 0)
    check_size(path, 2 * height * width, len(packed), compressed=True)
    return np.asarray(imagecodecs.jpegls_decode(packed))
