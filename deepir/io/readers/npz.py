"""NumPy's `.npz`: named arrays in a zip archive. Nothing is ever unpickled."""

from __future__ import annotations

import zipfile
from pathlib import Path

from deepir.errors import DataError, nearest
from deepir.io.guards import check_size
from deepir.io.readers import Array, npy

SUFFIXES = (".npz",)
DEFAULT_KEY = "frames"


def sniff(head: bytes, path: Path) -> bool:
    """A zip archive, with or without members."""
    return head.startswith((b"PK\x03\x04", b"PK\x05\x06"))


def read(path: Path, key: str | None) -> Array:
    """The array `key`, else `frames`, else the only array with two or three dimensions.

    Raises `DataError`, with the arrays there are, where that is none or several.
    """
    with zipfile.ZipFile(path) as archive:
        members = _members(archive, path)
        return _read_member(archive, members[_choose(archive, members, path, key)], path)


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


def _choose(
    archive: zipfile.ZipFile, members: dict[str, zipfile.ZipInfo], path: Path, key: str | None
) -> str:
    if key is not None and key not in members:
        raise DataError(f"{path}: no array '{key}'; {nearest(key, members)}")
    if key is not None or DEFAULT_KEY in members:
        return key or DEFAULT_KEY
    shapes = {}
    for name, info in members.items():
        with archive.open(info) as stream:
            shapes[name] = npy.read_header(stream, path)[0]
    pictures = [name for name, shape in shapes.items() if len(shape) in (2, 3)]
    if len(pictures) != 1:
        listing = ", ".join(f"{name} {shape}" for name, shape in sorted(shapes.items()))
        raise DataError(f"{path}: which array is meant? Give its key (data.key). Arrays: {listing}")
    return pictures[0]


def _read_member(archive: zipfile.ZipFile, info: zipfile.ZipInfo, path: Path) -> Array:
    with archive.open(info) as stream:
        return npy.read_stream(stream, Path(f"{path}[{info.filename.removesuffix('.npy')}]"), info.file_size)
