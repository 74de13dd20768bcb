"""A folder, or a glob such as `flight/*.tiff`: one burst from many files, in natural order."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from deepir.errors import DataError
from deepir.io import readers
from deepir.io.guards import GIB, MAX_ARRAY_BYTES, warn_once
from deepir.io.radiometry import Radiometry
from deepir.io.readers import Array, Reader

HEADER_SUFFIX = ".hdr"  # of the headers of ENVI, which stand beside their samples


class Folder(Reader):
    """One burst from many files."""

    name = "folder"

    def sniff(self, head: bytes, path: Path) -> bool:
        """A folder, or a name with wildcards that is not itself a file."""
        return path.is_dir() or readers.is_glob(path)

    def read(self, path: Path, key: str | None) -> Array:
        """Frames (N, h, w) of all pictures; a file of several pages gives several frames."""
        stacks: list[Array] = []
        files, total = burst_files(path), 0
        for file in files:
            frames = readers.opened(file, key).read()
            stacks.append(frames if frames.ndim == 3 else frames[None])
            alike = [(" x ".join(map(str, each.shape[1:])), each.dtype) for each in (stacks[0], stacks[-1])]
            for what, one, other in zip(("size", "type"), *alike, strict=True):
                if one != other:
                    raise DataError(
                        f"{files[0].parent}: pictures differ in {what}: {files[0].name} is {one}, {file.name} is "
                        f"{other}; name one kind with a glob"
                    )
            total += frames.nbytes
            if total > MAX_ARRAY_BYTES:
                raise DataError(f"{path}: more than {MAX_ARRAY_BYTES // GIB} GiB of pictures; name fewer with a glob")
        return np.ma.concatenate(stacks) if any(map(np.ma.isMaskedArray, stacks)) else np.concatenate(stacks)

    def stream(self, path: Path, key: str | None) -> Iterator[Array]:
        """Frame after frame, file after file."""
        for file in burst_files(path):
            yield from readers.opened(file, key).stream()

    def radiometries(self, path: Path, key: str | None) -> list[Radiometry | None]:
        """Radiometry of each frame of each picture."""
        files = [readers.opened(file, key) for file in burst_files(path)]
        of_files = [file.radiometries() for file in files]
        if len({law for laws in of_files for law in laws}) == 1:
            return of_files[0]
        laws: list[Radiometry | None] = []
        for file, own in zip(files, of_files, strict=True):
            laws += own if len(own) > 1 else own * sum(1 for _ in file.stream())
        return laws


def burst_files(path: Path) -> list[Path]:
    """Files of a folder or a glob, in natural order (frame2 before frame10), without hidden files.

    A folder's files are those recognised by their contents, or with a known suffix, so that a damaged file is an error
    and not a missing frame. A glob stands for all its files.

    Of a folder in which pictures with a raw plane and others lie side by side, only the former are taken.

    Raises:
        DataError: There are none, or of several formats.
    """
    if path.is_dir():
        entries = _pictures(path)
    else:
        matches = Path(path.anchor or ".").glob(str(path.relative_to(path.anchor)))
        entries = [file for file in matches if file.is_file() and not file.name.startswith(".")]
    if not entries:
        what = "no pictures in this folder" if path.is_dir() else "no file matches"
        raise DataError(f"{path}: {what} ({', '.join(readers.suffixes())} are read)")
    return in_order(entries)


def in_order(files: Sequence[Path]) -> list[Path]:
    """Files by the numbers in their names: nine digits and more are seconds with decimals, steps may be negative."""
    ends = {file: re.fullmatch(r"(.*?)(-?)(\d+)(\.\D[^.]*)?", str(file)) for file in files}
    steps, others = ({end[1] for end in ends.values() if end and end[2] == sign} for sign in ("-", ""))

    def key(file: Path) -> list[Any]:
        name, step, end = str(file), [], ends[file]
        if end and end[1] in steps & others:
            name, step = end[1], [Decimal(end[2] + end[3])]
        parts = re.split(r"(\d{9,}\.\d+|\d+)", name.casefold())
        return [Decimal(part) if i % 2 else part for i, part in enumerate(parts)] + step

    return sorted(files, key=key)


def _pictures(path: Path) -> list[Path]:
    """The pictures of a folder, those with a raw plane if there are any; damaged ones stay, so that they are named."""
    files = [file for file in path.iterdir() if file.is_file() and not file.name.startswith(".")]
    files = [file for file in files if file.suffix.lower() != HEADER_SUFFIX]
    found = {file: reader for file in files if file.stat().st_size and (reader := readers.find_reader(file))}
    files = [file for file in files if file in found or file.suffix.lower() in readers.suffixes()]
    plain = {file: reader.name for file, reader in found.items() if not reader.holds_raw_plane}
    if 0 < len(plain) < len(found):
        warn_once(f"{path}: {len(found) - len(plain)} pictures hold raw counts; {len(plain)} others are left out")
        return [file for file in files if file not in plain]
    if len(set(plain.values())) > 1:
        kinds = sorted({file.suffix for file in plain})
        raise DataError(
            f"{path}: files of several formats lie side by side ({', '.join(kinds)}); name one kind with a glob, "
            f"such as '{path}/*{kinds[-1]}'"
        )
    return files
