"""Writing results, each file whole or not at all."""

from __future__ import annotations

import json
import math
import os
import secrets
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from deepir.errors import DataError
from deepir.io.output.tone_mapping import PERCENTILE, TONE_MAPPINGS, WHITE_HOT, apply_palette

PathLike = str | os.PathLike[str]


@contextmanager
def atomic_file(path: PathLike) -> Iterator[Path]:
    """Give a temporary file's name beside `path`; when the block ends without an error, it becomes `path`.

    Whoever reads `path` meanwhile, or after a crash, sees the old file or the new one, never a part.
    Raises `DataError` where it cannot be written.
    """
    target = Path(path)
    # Made by name and not by `tempfile`, whose files nobody else may read.
    temporary = target.with_name(f".{target.stem}.{secrets.token_hex(4)}{target.suffix}")
    try:
        yield temporary
        with temporary.open("r+b") as file:
            os.fsync(file.fileno())
        temporary.replace(target)
    except OSError as error:
        raise DataError(f"{target}: cannot be written: {error.strerror or error}") from error
    finally:
        with suppress(OSError):
            temporary.unlink()


def write_npz(path: PathLike, arrays: Mapping[str, np.ndarray[Any, Any]]) -> None:
    """Write named arrays as a compressed `.npz`. Raises `DataError` for arrays of Python objects."""
    for name, array in arrays.items():
        if np.asarray(array).dtype.hasobject:
            raise DataError(f"{path}: '{name}' holds Python objects; only plain arrays are written")
    with atomic_file(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]


def write_json(path: PathLike, content: Any) -> None:
    """Write JSON. Numpy's numbers and arrays become plain; NaN and infinity, not in JSON, become null."""
    text = json.dumps(to_json_types(content), indent=2, allow_nan=False, ensure_ascii=False)
    with atomic_file(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def write_tiff(
    path: PathLike, frames: np.ndarray[Any, Any], metadata: Mapping[str, Any] | None = None
) -> None:
    """Write `(h, w)` or `(N, h, w)` as float32 TIFF; ImageDescription holds `metadata` as JSON."""
    import tifffile

    description = json.dumps(to_json_types(metadata or {}), allow_nan=False)
    with atomic_file(path) as temporary:
        tifffile.imwrite(
            temporary,
            np.asarray(frames, np.float32),
            photometric="minisblack",
            description=description,
            metadata=None,
        )


def write_preview(
    path: PathLike, image: np.ndarray[Any, Any], palette: str = WHITE_HOT, mapping: str = PERCENTILE
) -> None:
    """Write `(h, w)` as an 8-bit PNG to look at, in a palette and by a tone mapping, see `tone_mapping`."""
    from PIL import Image

    shades = TONE_MAPPINGS[mapping](image)
    with atomic_file(path) as temporary:
        Image.fromarray(apply_palette(shades, palette)).save(temporary, format="PNG")


def write_mat(path: PathLike, arrays: Mapping[str, np.ndarray[Any, Any]]) -> None:
    """Write named arrays for MATLAB (version 5), axes as they are."""
    import scipy.io

    with atomic_file(path) as temporary, temporary.open("wb") as file:
        scipy.io.savemat(file, dict(arrays), do_compression=True)


def to_json_types(value: Any) -> Any:
    """`value` in JSON's own types; NaN and infinity, not in JSON, become null."""
    if isinstance(value, Mapping):
        return {str(key): to_json_types(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_json_types(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return to_json_types(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, os.PathLike) else value
