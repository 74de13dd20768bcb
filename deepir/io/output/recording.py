"""Recordings written frame by frame, each file atomically: TIFF for measurements, MP4 for display."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from deepir.errors import DataError
from deepir.io.guards import import_optional
from deepir.io.output.tone_mapping import PERCENTILE, TONE_MAPPINGS, colour_table, display_limits, stretch
from deepir.io.output.write import atomic_file

Array = np.ndarray[Any, Any]
Write = Callable[[Array], None]
FILM_FRAME_RATE = 30  # frames a second of a film


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
                cast(frame, dtype),
                photometric="minisblack",
                description=description,
                metadata=None,
                contiguous=True,
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
                track = _track(av, container, frame.shape)
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


def _track(av: Any, container: Any, shape: tuple[int, ...]) -> Any:
    codec = "libx264" if "libx264" in av.codecs_available else "mpeg4"
    track = container.add_stream(codec, rate=FILM_FRAME_RATE)
    track.height, track.width = (side // 2 * 2 for side in shape)
    track.pix_fmt = "yuv420p"
    return track


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
