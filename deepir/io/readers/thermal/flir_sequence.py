"""FLIR's recordings SEQ and CSQ: one FFF for each frame, raw in SEQ and packed as JPEG-LS in CSQ."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from deepir.errors import DataError
from deepir.io.containers import fff
from deepir.io.containers.file_bytes import FileBytes
from deepir.io.guards import stack_frames, warn_once
from deepir.io.radiometry import Radiometry
from deepir.io.readers import Array

SUFFIXES = (".seq", ".csq", ".fff")


AFF_MAGIC = b"AFF\0"  # first bytes of an older kind of SEQ, with other records


def sniff(head: bytes, path: Path) -> bool:
    """First bytes of an FFF, or of an AFF, which is refused by name."""
    return head.startswith((fff.FFF_MAGIC, AFF_MAGIC))


def read(path: Path, key: str | None) -> Array:
    """All frames (N, h, w), uint16 counts.

    Raises:
        DataError: They differ in size.
    """
    return stack_frames(stream(path, key), path)


def radiometry(path: Path, key: str | None) -> Radiometry | None:
    """Radiometry of the first frame."""
    with FileBytes(path) as data:
        return fff.read_radiometry(fff.read_records(data, path)[0])


def radiometries(path: Path, key: str | None) -> list[Radiometry | None]:
    """Radiometry of each frame: emissivity, distance or the camera's range may change while it records."""
    laws: list[Radiometry | None] = []
    with FileBytes(path) as data:
        start = 0
        while start != -1:
            try:
                found, end = fff.read_records(data, path, start, (fff.CAMERA_RECORD,))
            except Exception:  # where `stream` ends, or says what is wrong
                break
            laws.append(fff.read_radiometry(found))
            start = data.find(fff.FFF_MAGIC, end)
    return laws or [None]


def stream(path: Path, key: str | None) -> Iterator[Array]:
    """Frame after frame (h, w); of a recording whose last frame is cut off, the whole ones, with a warning."""
    with FileBytes(path) as data:
        if data[:4] == AFF_MAGIC:
            raise DataError(
                f"{path}: FLIR's older SEQ (AFF), which is not read; export it as CSQ, TIFF or radiometric JPEG with "
                "FLIR's software"
            )
        start, count = 0, 0
        while start != -1:
            try:
                found, end = fff.read_records(data, path, start)
                plane = fff.read_raw_plane(found, path)
            except Exception:
                if not count or data.find(fff.FFF_MAGIC, start + len(fff.FFF_MAGIC)) != -1:
                    raise
                warn_once(f"{path}: its last frame is cut off; the {count} whole ones are read")
                return
            yield plane
            count += 1
            start = data.find(fff.FFF_MAGIC, end)
