"""Writing results, each file atomically."""

from __future__ import annotations

import json
import math
import os
import secrets
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

import numpy as np

from deepir.errors import DataError
from deepir.io.output.tone_mapping import PERCENTILE, TONE_MAPPINGS, WHITE_HOT, apply_palette

PathLike = str | os.PathLike[str]


@contextmanager
def atomic_file(path: PathLike) -> Iterator[Path]:
    """A context with the name of a temporary file, which replaces `path` if the block ends without an error.

    Readers see the old file or the new one, never a part, even after a crash.

    Raises:
        DataError: It cannot be written.
    """
    with atomic_files(path) as (temporary,):
        yield temporary


@contextmanager
def atomic_files(*paths: PathLike) -> Iterator[list[Path]]:
    """`atomic_file` for files that belong together: none is replaced before all are written.

    Raises:
        DataError: One cannot be written.
    """
    targets = [Path(path) for path in paths]
    # Made by name and not by `tempfile`, whose files nobody else may read.
    temporaries = [each.with_name(f".{each.stem}.{secrets.token_hex(4)}{each.suffix}") for each in targets]
    try:
        yield temporaries
        for temporary in temporaries:
            with temporary.open("r+b") as file:
                os.fsync(file.fileno())
        for temporary, target in zip(temporaries, targets, strict=True):
            temporary.replace(target)
    except OSError as error:
        names = ", ".join(map(str, targets))
        why = error.strerror or f"the disk may be full ({error})"  # NumPy's says only how much was written
        raise DataError(f"{names}: cannot be written: {why}") from error
    finally:
        for temporary in temporaries:
            with suppress(OSError):
                temporary.unlink()


def write_npz(path: PathLike, arrays: Mapping[str, np.ndarray[Any, Any]]) -> None:
    """Write named arrays as a compressed `.npz`.

    Raises:
        DataError: An array holds Python objects.
    """
    for name, array in arrays.items():
        if np.asarray(array).dtype.hasobject:
            raise DataError(f"{path}: '{name}' holds Python objects; only plain arrays are written")
    with atomic_file(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]


def write_json(path: PathLike, content: Any) -> None:
    """Write JSON; NumPy's numbers and arrays become plain, NaN and infinity become null."""
    text = json.dumps(to_json_types(content), indent=2, allow_nan=False, ensure_ascii=False)
    with atomic_file(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def write_tiff(path: PathLike, frames: np.ndarray[Any, Any], metadata: Mapping[str, Any] | None = None) -> None:
    """Write (h, w) or (N, h, w) as float32 TIFF; ImageDescription holds `metadata` as JSON."""
    with atomic_file(path) as temporary:
        save_tiff(temporary, frames, metadata or {})


def save_tiff(file: Path | IO[bytes], frames: np.ndarray[Any, Any], metadata: Mapping[str, Any]) -> None:
    """The same into an open file."""
    import tifffile

    tifffile.imwrite(
        file,
        np.asarray(frames, np.float32),
        photometric="minisblack",
        description=json.dumps(to_json_types(metadata), allow_nan=False),
        metadata=None,
    )


def write_preview(
    path: PathLike, image: np.ndarray[Any, Any], palette: str = WHITE_HOT, mapping: str = PERCENTILE
) -> None:
    """Write an image (h, w) as an 8-bit PNG, in a palette and a tone mapping of `tone_mapping`."""
    from PIL import Image

    shades = TONE_MAPPINGS[mapping](image)
    with atomic_file(path) as temporary:
        Image.fromarray(apply_palette(shades, palette)).save(temporary, format="PNG")


def write_mat(path: PathLike, arrays: Mapping[str, np.ndarray[Any, Any]]) -> None:
    """Write named arrays for MATLAB (version 5)."""
    import scipy.io

    with atomic_file(path) as temporary, temporary.open("wb") as file:
        scipy.io.savemat(file, dict(arrays), do_compression=True)


def to_json_types(value: Any) -> Any:
    """A value in JSON's types; NaN and infinity become null."""
    if isinstance(value, Mapping):
        return {str(key): to_json_types(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_json_types(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return to_json_types(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, os.PathLike) else value
