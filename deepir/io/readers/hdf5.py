"""HDF5 and MATLAB 7.3 (an HDF5 file): named arrays. Needs the extra `hdf5`. Links to other files are not followed."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from deepir.errors import DataError
from deepir.io.guards import check_size, import_optional, masked
from deepir.io.radiometry import ZERO_CELSIUS, Linear, Radiometry
from deepir.io.readers import Array, Reader, choose_array

HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"  # first bytes of an HDF5 file
MATLAB_SIGNATURE = b"MATLAB 7.3 MAT-file"  # first bytes of MATLAB's user block before it
#: Kelvin at zero of the units of temperature, in small letters, with `deg` for all words of degrees.
UNITS = dict.fromkeys(("k", "kelvin", "kelvins", "degk", "degkelvin"), 0.0) | dict.fromkeys(
    ("c", "celsius", "degc", "degcelsius"), ZERO_CELSIUS
)
DEGREES = re.compile("degrees?|°|[ _]")  # in the name of a unit


class Hdf5(Reader):
    """Named arrays; MATLAB's (h, w, N) become (N, h, w)."""

    name = "hdf5"
    suffixes = (".h5", ".hdf5", ".mat")
    signatures = (HDF5_SIGNATURE, MATLAB_SIGNATURE)
    any_axes = True

    def read(self, path: Path, key: str | None) -> Array:
        """The stored array, the `key` of which is its path in the file; MATLAB's (h, w, N) becomes (N, h, w)."""
        with _dataset(path, key, at_once=True) as (data, turned):
            return _turned(_known(data[()], data.attrs), turned)

    def radiometries(self, path: Path, key: str | None) -> list[Radiometry | None]:
        """Kelvin by the scale and offset of the conventions for climate and forecast (CF)."""
        try:
            with _dataset(path, key) as (data, _):
                unit = _text(data.attrs, "units")
                scale, zero = (_number(data.attrs, *each) for each in (("scale_factor", 1.0), ("add_offset", 0.0)))
        except DataError:  # several arrays, or none
            return [None]
        known = DEGREES.sub(lambda found: "" if found[0] in " _" else "deg", unit.lower())
        if known not in UNITS or not scale > 0:
            return [None]
        return [Linear(scale, zero + UNITS[known])]

    def stream(self, path: Path, key: str | None) -> Iterator[Array]:
        """Frame after frame (h, w) of the same array."""
        with _dataset(path, key) as (data, turned):
            if data.ndim != 3:
                yield _turned(_known(data[()], data.attrs), turned)
                return
            stored = path.stat().st_size
            for number in range(len(data)):
                frame = data[number]
                if path.stat().st_size < stored:  # the library would give zeros
                    raise DataError(f"{path}: truncated while it was read, at frame {number} of {len(data)}")
                yield _turned(_known(frame, data.attrs), turned)


@contextmanager
def _dataset(path: Path, key: str | None, *, at_once: bool = False) -> Iterator[tuple[Any, bool]]:
    """The chosen array, unread, and whether it is MATLAB's; `at_once`: it is going to be read as a whole."""
    library = import_optional("h5py", "hdf5", str(path))
    with path.open("rb") as stream:
        matlab = stream.read(len(MATLAB_SIGNATURE)) == MATLAB_SIGNATURE
        with library.File(stream, "r") as file:
            found: dict[str, Any] = {}

            def collect(name: str, each: Any) -> None:
                if isinstance(each, library.Dataset) and each.shape is not None and each.dtype.kind in "uif":
                    found[name] = each

            file.visititems(collect)  # which follows no links, and comes to each object once
            name = choose_array({each: data.shape for each, data in found.items()}, path, key)
            data = found[name]
            if data.is_virtual or data.external:
                raise DataError(f"{path}: {name} keeps its values in other files, which are never opened")
            compressed = data.chunks is not None
            check_size(path, data.nbytes, path.stat().st_size, compressed=compressed, at_once=at_once)
            yield data, matlab


def _known(array: Array, attributes: Any) -> Array:
    """Masked where samples hold a fill value that the file names or lie outside the range that it calls valid."""
    named = [np.asarray(attributes[name]).ravel() for name in ("_FillValue", "missing_value") if name in attributes]
    lost = np.isin(array, np.concatenate(named)) if named else np.zeros(1, bool)
    low, high = np.asarray(attributes.get("valid_range", (np.nan, np.nan))).ravel()[:2]
    low, high = _number(attributes, "valid_min", low), _number(attributes, "valid_max", high)
    lost = lost | (array < low) | (array > high)
    if str(_text(attributes, "_Unsigned")).lower() == "true" and array.dtype.kind == "i":
        array = array.view(f"{array.dtype.byteorder}u{array.dtype.itemsize}")
    return masked(array, lost)


def _text(attributes: Any, name: str) -> str:
    value = attributes.get(name, "")
    return value.decode() if isinstance(value, bytes) else str(value)


def _number(attributes: Any, name: str, default: float) -> float:
    value = np.asarray(attributes.get(name, default)).ravel()
    return float(value[0]) if value.size and value.dtype.kind in "uif" else default


def _turned(array: Array, matlab: bool) -> Array:
    return np.swapaxes(array, -1, -2) if matlab else array
