"""NumPy's `.npz`: named arrays in a zip archive. Nothing is unpickled."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from pathlib import Path

from deepir.errors import DataError
from deepir.io.containers.named_arrays import choose_array
from deepir.io.guards import check_size
from deepir.io.readers import Array
from deepir.io.readers.arrays import npy

ANY_AXES = True
SUFFIXES = (".npz",)


def sniff(head: bytes, path: Path) -> bool:
    """A zip archive, with or without members."""
    return head.startswith((b"PK\x03\x04", b"PK\x05\x06"))


def read(path: Path, key: str | None) -> Array:
    """The array `key`, or the one that `choose_array` selects."""
    with zipfile.ZipFile(path) as archive:
        return _read_member(archive, _chosen(archive, path, key), path)


def stream(path: Path, key: str | None) -> Iterator[Array]:
    """Frame after frame (h, w) of the same array."""
    with zipfile.ZipFile(path) as archive:
        info = _chosen(archive, path, key, at_once=False)
        with archive.open(info) as member:
            yield from npy.stream_frames(member, path, info.file_size)


def read_all(path: Path) -> dict[str, Array]:
    """Every array of the archive by its name."""
    with zipfile.ZipFile(path) as archive:
        return {name: _read_member(archive, info, path) for name, info in _members(archive, path).items()}


def _chosen(
    archive: zipfile.ZipFile, path: Path, key: str | None, *, at_once: bool = True
) -> zipfile.ZipInfo:
    members = _members(archive, path, at_once=at_once)
    shapes = {name: _shape(archive, info, path) for name, info in members.items()}
    return members[choose_array(shapes, path, key)]


def _members(archive: zipfile.ZipFile, path: Path, *, at_once: bool = True) -> dict[str, zipfile.ZipInfo]:
    members = {
        info.filename.removesuffix(".npy"): info
        for info in archive.infolist()
        if info.filename.endswith(".npy")
    }
    if not members:
        raise DataError(f"{path}: a zip archive without NumPy arrays; save the frames with np.savez")
    declared, stored = sum(info.file_size for info in members.values()), path.stat().st_size
    check_size(path, declared, stored, compressed=True, at_once=at_once)
    check_size(path, sum(info.compress_size for info in members.values()), stored, at_once=False)
    return members


def _shape(archive: zipfile.ZipFile, info: zipfile.ZipInfo, path: Path) -> tuple[int, ...]:
    with archive.open(info) as stream:
        return npy.read_header(stream, path)[0]


def _read_member(archive: zipfile.ZipFile, info: zipfile.ZipInfo, path: Path) -> Array:
    with archive.open(info) as stream:
        return npy.read_stream(stream, Path(f"{path}[{info.filename.removesuffix('.npy')}]"), info.file_size)
