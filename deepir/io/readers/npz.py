"""NumPy's `.npz`: named arrays in a zip archive. Nothing is ever unpickled."""

from __future__ import annotations

import zipfile
from pathlib import Path

from deepir.errors import DataError
from deepir.io.guards import check_size
from deepir.io.named import choose
from deepir.io.readers import Array, npy

SUFFIXES = (".npz",)


def sniff(head: bytes, path: Path) -> bool:
    """A zip archive, with or without members."""
    return head.startswith((b"PK\x03\x04", b"PK\x05\x06"))


def read(path: Path, key: str | None) -> Array:
    """The array `key`, or the one that `choose` takes for the frames."""
    with zipfile.ZipFile(path) as archive:
        members = _members(archive, path)
        shapes = {name: _shape(archive, info, path) for name, info in members.items()}
        return _read_member(archive, members[choose(shapes, path, key)], path)


def read_all(path: Path) -> dict[str, Array]:
    """Every array of the archive by its name."""
    with zipfile.ZipFile(path) as archive:
        return {name: _read_member(archive, info, path) for name, info in _members(archive, path).items()}


def _members(archive: zipfile.ZipFile, path: Path) -> dict[str, zipfile.ZipInfo]:
    members = {
        info.filename.removesuffix(".npy"): info
        for info in archive.infolist()
        if info.filename.endswith(".npy")
    }
    if not members:
        raise DataError(f"{path}: a zip archive without NumPy arrays; save the frames with np.savez")
    check_size(path, sum(i.file_size for i in members.values()), path.stat().st_size, compressed=True)
    return members


def _shape(archive: zipfile.ZipFile, info: zipfile.ZipInfo, path: Path) -> tuple[int, ...]:
    with archive.open(info) as stream:
        return npy.read_header(stream, path)[0]


def _read_member(archive: zipfile.ZipFile, info: zipfile.ZipInfo, path: Path) -> Array:
    with archive.open(info) as stream:
        return npy.read_stream(stream, Path(f"{path}[{info.filename.removesuffix('.npy')}]"), info.file_size)
