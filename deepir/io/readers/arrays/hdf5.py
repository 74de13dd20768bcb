"""HDF5 and MATLAB 7.3 (an HDF5 file): named arrays. Needs the extra `hdf5`. Links to other files are not followed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from deepir.errors import DataError
from deepir.io.containers.named_arrays import choose_array
from deepir.io.extras import import_optional
from deepir.io.guards import check_size
from deepir.io.readers import Array

SUFFIXES = (".h5", ".hdf5", ".mat")
HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"  # first bytes of an HDF5 file
MATLAB_SIGNATURE = b"MATLAB 7.3 MAT-file"  # first bytes of MATLAB's user block before it
MAX_GROUP_DEPTH = 8  # levels of groups that are searched
MAX_ARRAYS = 10_000  # arrays and groups that are listed


def sniff(head: bytes, path: Path) -> bool:
    """HDF5's signature, or MATLAB's text before it."""
    return head.startswith((HDF5_SIGNATURE, MATLAB_SIGNATURE))


def read(path: Path, key: str | None) -> Array:
    """The stored array; MATLAB's (h, w, N) becomes (N, h, w).

    Args:
        path: The file.
        key: Path of the array in the file.

    Raises:
        DataError: Several arrays are possible, or the data are in other files.
    """
    with _dataset(path, key) as (data, turned):
        check_size(path, data.nbytes, path.stat().st_size, compressed=True)
        return _turned(data[()], turned)


def stream(path: Path, key: str | None) -> Iterator[Array]:
    """Frame after frame (h, w) of the same array."""
    with _dataset(path, key) as (data, turned):
        if data.ndim != 3:
            yield _turned(data[()], turned)
            return
        stored = path.stat().st_size
        for number in range(len(data)):
            frame = data[number]
            if path.stat().st_size < stored:  # the library would give zeros
                raise DataError(f"{path}: truncated while it was read, at frame {number} of {len(data)}")
            yield _turned(frame, turned)


@contextmanager
def _dataset(path: Path, key: str | None) -> Iterator[tuple[Any, bool]]:
    """The chosen array, unread, and whether it is MATLAB's."""
    library = import_optional("h5py", "hdf5", str(path))
    with path.open("rb") as stream:
        matlab = stream.read(len(MATLAB_SIGNATURE)) == MATLAB_SIGNATURE
        with library.File(stream, "r") as file:
            found: dict[str, Any] = {}
            _collect(library, file, "", found)
            name = choose_array({each: data.shape for each, data in found.items()}, path, key)
            data = found[name]
            if data.is_virtual or data.external:
                raise DataError(f"{path}: {name} keeps its values in other files, which are never opened")
            compressed = data.chunks is not None
            check_size(path, data.nbytes, path.stat().st_size, compressed=compressed, at_once=False)
            yield data, matlab


def _turned(array: Array, matlab: bool) -> Array:
    return np.swapaxes(array, -1, -2) if matlab else array


def _collect(library: Any, group: Any, prefix: str, found: dict[str, Any]) -> None:
    """Collect the arrays of numbers below `group` by path; only hard links are followed, to a limited depth."""
    for name in group:
        if len(found) > MAX_ARRAYS or prefix.count("/") > MAX_GROUP_DEPTH:
            raise DataError(f"{group.file.filename}: more arrays or folders than a recording has")
        if not isinstance(group.get(name, getlink=True), library.HardLink):
            continue
        each = group[name]
        if isinstance(each, library.Group):
            _collect(library, each, f"{prefix}{name}/", found)
        elif isinstance(each, library.Dataset) and each.shape is not None and each.dtype.kind in "uif":
            found[prefix + name] = each
