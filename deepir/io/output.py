"""Writing results and recordings, each file atomically."""

from __future__ import annotations

import json
import math
import os
import secrets
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

import numpy as np

from deepir.arrays import Array
from deepir.errors import DataError
from deepir.io.guards import import_optional
from deepir.io.tone_mapping import (
    PERCENTILE,
    TONE_MAPPINGS,
    WHITE_HOT,
    apply_palette,
    colour_table,
    display_limits,
    stretch,
)

PathLike = str | os.PathLike[str]
Write = Callable[[Array], None]


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


def write_npz(path: PathLike, arrays: Mapping[str, Array]) -> None:
    """Write named arrays as a compressed `.npz`.

    Raises:
        DataError: An array holds Python objects.
    """
    for name, array in arrays.items():
        if np.asarray(array).dtype.hasobject:
            raise DataError(f"{path}: '{name}' holds Python objects; only plain arrays are written")
    with atomic_file(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]


def write_text(path: PathLike, text: str) -> None:
    """Write a text, UTF-8."""
    with atomic_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: PathLike, content: Any) -> None:
    """Write JSON; NumPy's numbers and arrays become plain, NaN and infinity become null."""
    write_text(path, json.dumps(to_json_types(content), indent=2, allow_nan=False, ensure_ascii=False) + "\n")


def write_tiff(path: PathLike, frames: Array, metadata: Mapping[str, Any] | None = None) -> None:
    """Write (h, w) or (N, h, w) as float32 TIFF; ImageDescription holds `metadata` as JSON."""
    with atomic_file(path) as temporary:
        save_tiff(temporary, frames, metadata or {})


def save_tiff(file: Path | IO[bytes], frames: Array, metadata: Mapping[str, Any]) -> None:
    """Write (h, w) or (N, h, w) as float32 TIFF to a name or into an open file, `metadata` in its ImageDescription."""
    import tifffile

    tifffile.imwrite(
        file,
        np.asarray(frames, np.float32),
        photometric="minisblack",
        description=json.dumps(to_json_types(metadata), allow_nan=False),
        metadata=None,
    )


def write_preview(path: PathLike, image: Array, palette: str = WHITE_HOT, mapping: str = PERCENTILE) -> None:
    """Write an image (h, w) as an 8-bit PNG, in a palette and a tone mapping of `tone_mapping`."""
    from PIL import Image

    shades = TONE_MAPPINGS[mapping](image)
    with atomic_file(path) as temporary:
        Image.fromarray(apply_palette(shades, palette)).save(temporary, format="PNG")


def write_mat(path: PathLike, arrays: Mapping[str, Array]) -> None:
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


@contextmanager
def tiff(path: Path, dtype: np.dtype[Any], metadata: Mapping[str, Any]) -> Iterator[Write]:
    """A context with a function that appends a frame (h, w) as a page; integers are rounded and clipped to their range.

    Args:
        path: The file.
        dtype: Type of the samples.
        metadata: Written as JSON into the description of the first page.

    Raises:
        DataError: It cannot be written.
    """
    import tifffile

    description = json.dumps(dict(metadata))
    with atomic_file(path) as temporary, tifffile.TiffWriter(temporary, bigtiff=True) as file:

        def write(frame: Array) -> None:
            file.write(
                cast(frame, dtype), photometric="minisblack", description=description, metadata=None, contiguous=True
            )

        yield write


def output_type(recorded: np.dtype[Any], *, rounded: bool) -> np.dtype[Any]:
    """The recording's own type for 8 or 16 bits if values may be `rounded` to it, else float32."""
    keeps = rounded and recorded.kind == "u" and recorded.itemsize <= 2
    return recorded.newbyteorder("=") if keeps else np.dtype(np.float32)


def cast(frame: Array, dtype: np.dtype[Any]) -> Array:
    """Values in another type; integers are rounded and clipped, and NaN becomes their least value."""
    if dtype.kind == "f":
        return frame.astype(dtype, copy=False)
    limits = np.iinfo(dtype)
    whole = np.rint(frame)
    np.fmax(whole, limits.min, out=whole)  # of NaN and a number it takes the number
    np.fmin(whole, limits.max, out=whole)
    return whole.astype(dtype)


@contextmanager
def mp4(path: Path, palette: str, mapping: str) -> Iterator[Write]:
    """A context with a function that appends a frame (h, w) to a film, for display.

    `percentile` uses the range of the first frame for all, so that the film does not flicker. An odd last row or column
    is dropped, as the codec requires.

    Args:
        path: The file.
        palette: One of `PALETTES`.
        mapping: One of `TONE_MAPPINGS`.

    Raises:
        DataError: The extra `video` is missing.
    """
    av = import_optional("av", "video", str(path))
    colours = colour_table(palette)
    with atomic_file(path) as temporary, av.open(temporary, "w") as container:
        track: Any = None
        low = high = 0.0

        def write(frame: Array) -> None:
            nonlocal track, low, high
            if track is None:
                codec = "libx264" if "libx264" in av.codecs_available else "mpeg4"
                track = container.add_stream(codec, rate=30)
                track.height, track.width = (side // 2 * 2 for side in frame.shape)
                track.pix_fmt = "yuv420p"
                low, high = display_limits(frame)
            shades = stretch(frame, low, high) if mapping == PERCENTILE else TONE_MAPPINGS[mapping](frame)
            picture = colours[np.round(255 * shades[: track.height, : track.width]).astype(np.uint8)]
            container.mux(track.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))

        yield write
        if track is not None:
            container.mux(track.encode())


def write_frames(frames: Iterable[Array], write: Write) -> int:
    """Write frames (h, w), each while the next is computed.

    Args:
        frames: Computed one by one.
        write: Of `open_writer`.

    Returns:
        Their number.
    """
    count = 0
    written: Future[None] | None = None
    with ThreadPoolExecutor(1) as behind:
        for frame in frames:
            if written is not None:
                written.result()
            written = behind.submit(write, frame)
            count += 1
        if written is not None:
            written.result()
    return count


def open_writer(path: Path, dtype: np.dtype[Any], metadata: Mapping[str, Any], palette: str, mapping: str) -> Any:
    """`tiff` or `mp4`, by the name of `path`.

    Raises:
        DataError: The name is another.
    """
    if path.suffix.lower() in (".tif", ".tiff"):
        return tiff(path, dtype, metadata)
    if path.suffix.lower() == ".mp4":
        return mp4(path, palette, mapping)
    raise DataError(f"{path}: a recording is written as .tif (values) or .mp4 (to look at)")
