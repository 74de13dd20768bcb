"""NumPy's `.npy`, one array, and `.npz`, named ones in a zip archive. Nothing is unpickled."""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy_format

from deepir.errors import DataError
from deepir.io.guards import check_size, read_planes
from deepir.io.readers import Array, Reader, choose_array, decoding, find_reader

MAX_HEADER_BYTES = 10_000  # that NumPy parses
Header = tuple[tuple[int, ...], bool, np.dtype[Any]]


class Npy(Reader):
    """One array."""

    name = "npy"
    suffixes = (".npy",)
    signatures = (npy_format.MAGIC_PREFIX,)
    any_axes = True

    def read(self, path: Path, key: str | None) -> Array:
        """The stored array."""
        with path.open("rb") as file:
            return _read_array(file, path, path.stat().st_size)

    def stream(self, path: Path, key: str | None) -> Iterator[Array]:
        """Frame after frame (h, w) of an array (N, h, w), else the array."""
        with path.open("rb") as file:
            yield from _stream_array(file, path, path.stat().st_size)


class Npz(Reader):
    """Named arrays in a zip archive."""

    name = "npz"
    suffixes = (".npz",)
    signatures = (b"PK\x03\x04", b"PK\x05\x06")  # with members, and without
    any_axes = True

    def read(self, path: Path, key: str | None) -> Array:
        """The array `key`, or the one that `choose_array` selects."""
        with zipfile.ZipFile(path) as archive:
            return _read_member(archive, _chosen(archive, path, key), path)

    def stream(self, path: Path, key: str | None) -> Iterator[Array]:
        """Frame after frame (h, w) of the same array."""
        with zipfile.ZipFile(path) as archive:
            info = _chosen(archive, path, key, at_once=False)
            with archive.open(info) as member:
                yield from _stream_array(member, path, info.file_size)


def read_npz(path: Path) -> dict[str, Array] | None:
    """Every array of an `.npz` by its name; None if the file is another one.

    Raises:
        DataError: It cannot be read.
    """
    with decoding(path):
        if not isinstance(find_reader(path), Npz):
            return None
        with zipfile.ZipFile(path) as archive:
            return {name: _read_member(archive, info, path) for name, info in _members(archive, path).items()}


def _header(stream: IO[bytes], path: Path) -> Header:
    """Shape, Fortran order and type; `stream` then stands at the first byte of the data."""
    version = npy_format.read_magic(stream)
    # Version 3 only adds the names of record fields outside Latin-1, and records are no frames.
    readers = {(1, 0): (2, npy_format.read_array_header_1_0), (2, 0): (4, npy_format.read_array_header_2_0)}
    if version not in readers:
        raise DataError(f"{path}: an array of format {version}; only plain arrays of numbers can be read")
    size, parse = readers[version]
    length = stream.read(size)
    if int.from_bytes(length, "little") > MAX_HEADER_BYTES:  # NumPy would take memory for it first
        raise DataError(f"{path}: damaged: its header claims {int.from_bytes(length, 'little'):,} bytes")
    return parse(io.BytesIO(length + stream.read(int.from_bytes(length, "little"))))


def _checked_header(stream: IO[bytes], path: Path, size: int, *, at_once: bool = True) -> Header:
    """The same, of numbers that a stream of `size` bytes can hold."""
    shape, fortran, dtype = _header(stream, path)
    if dtype.hasobject:
        raise DataError(f"{path}: holds pickled Python objects, which are never loaded; save plain numbers")
    check_size(path, math.prod(shape) * dtype.itemsize, size - stream.tell(), at_once=at_once)
    return shape, fortran, dtype


def _read_array(stream: IO[bytes], path: Path, size: int) -> Array:
    """One array from a stream of `size` bytes, at its beginning; `path` is for messages."""
    shape, fortran, dtype = _checked_header(stream, path, size)
    declared = math.prod(shape) * dtype.itemsize
    # To the end, not only `declared` bytes: a zip checks its checksum there.
    data = stream.read()
    if len(data) != declared:
        raise DataError(f"{path}: damaged: {len(data):,} bytes where the header says {declared:,}")
    return np.frombuffer(data, dtype).reshape(shape, order="F" if fortran else "C")


def _stream_array(stream: IO[bytes], path: Path, size: int) -> Iterator[Array]:
    """Frame after frame (h, w) of an array (N, h, w), else the array; arguments as in `_read_array`."""
    begin = stream.tell()
    shape, fortran, dtype = _checked_header(stream, path, size, at_once=False)
    plane = tuple(side for side in shape[1:] if side != 1)  # of (N, h, w), (N, 1, h, w) or (N, h, w, 1)
    if fortran or len(plane) != 2:
        stream.seek(begin)
        yield _read_array(stream, path, size)
        return
    yield from read_planes(stream, path, dtype, (shape[0], *plane))


def _chosen(archive: zipfile.ZipFile, path: Path, key: str | None, *, at_once: bool = True) -> zipfile.ZipInfo:
    members, shapes = _members(archive, path, at_once=at_once), {}
    for name, info in members.items():
        with archive.open(info) as stream:
            shapes[name] = _header(stream, path)[0]
    return members[choose_array(shapes, path, key)]


def _members(archive: zipfile.ZipFile, path: Path, *, at_once: bool = True) -> dict[str, zipfile.ZipInfo]:
    members = {
        info.filename.removesuffix(".npy"): info for info in archive.infolist() if info.filename.endswith(".npy")
    }
    if not members:
        raise DataError(f"{path}: a zip archive without NumPy arrays; save the frames with np.savez")
    declared, stored = sum(info.file_size for info in members.values()), path.stat().st_size
    check_size(path, declared, stored, compressed=True, at_once=at_once)
    check_size(path, sum(info.compress_size for info in members.values()), stored, at_once=False)
    return members


def _read_member(archive: zipfile.ZipFile, info: zipfile.ZipInfo, path: Path) -> Array:
    with archive.open(info) as stream:
        return _read_array(stream, Path(f"{path}[{info.filename.removesuffix('.npy')}]"), info.file_size)
