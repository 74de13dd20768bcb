"""FLIR's radiometric JPEG: the raw counts beside the coloured picture."""

from __future__ import annotations

from pathlib import Path

from deepir.errors import DataError
from deepir.io.containers import fff, jpeg
from deepir.io.radiometry import Radiometry
from deepir.io.readers import Array

SUFFIXES = (".jpg", ".jpeg")
APP1 = 0xE1  # marker of the segments with FLIR's records
FLIR_MARK = b"FLIR\0"  # first bytes of such a segment


def sniff(head: bytes, path: Path) -> bool:
    """A JPEG with a segment of FLIR's."""
    return head.startswith(jpeg.JPEG_SIGNATURE) and bool(_parts(path))


def read(path: Path, key: str | None) -> Array:
    """The raw plane (h, w), uint16 counts."""
    return fff.read_raw_plane(_records(path), path)


def radiometry(path: Path, key: str | None) -> Radiometry | None:
    """Planck's law with the camera's constants and the user's settings: emissivity, distance ..."""
    return fff.read_radiometry(_records(path))


def _records(path: Path) -> fff.Records:
    """FLIR's records, joined from the numbered segments."""
    parts = _parts(path)
    numbers = [part[6] for part in parts]
    if numbers != list(range(parts[0][7] + 1)):
        raise DataError(
            f"{path}: damaged or truncated: of FLIR's {parts[0][7] + 1} segments it has {len(parts)}"
        )
    return fff.read_records(b"".join(part[8:] for part in parts), path)[0]


def _parts(path: Path) -> list[bytes]:
    with path.open("rb") as file:
        found = [content for marker, content in jpeg.segments(file) if marker == APP1]
    return [content for content in found if content.startswith(FLIR_MARK) and len(content) >= 8]
