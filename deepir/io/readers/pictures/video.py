"""Grey videos: AVI, MP4, Matroska, MOV. Needs the extra `video`. Most are 8 bits, stretched by the camera."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from deepir.errors import DataError
from deepir.io.extras import import_optional
from deepir.io.guards import check_size, stack_frames, to_grey
from deepir.io.readers import Array

GENERIC = True
#: Difference of the channels, as a share of the range, that a lossy codec may give a grey film.
GREY_TOLERANCE = 0.02
#: Formats of grey films of 9 to 16 bits that keep their counts; in others they are stretched to 16.
DEEP_GREY = tuple(f"gray{bits}le" for bits in (9, 10, 12, 14, 16))
#: What uncompressed AVI and MOV of 16 bits are taken for, whatever they hold.
PACKED_SIXTEEN = ("rgb555le", "rgb555be", "rgb565le", "rgb565be", "bgr555le", "bgr565le")
SUFFIXES = (".avi", ".mp4", ".mkv", ".mov")


def sniff(head: bytes, path: Path) -> bool:
    """The signatures of AVI, MP4 and MOV, and Matroska."""
    return (
        head[4:8] == b"ftyp" or (head[:4], head[8:12]) == (b"RIFF", b"AVI ") or head[:4] == b"\x1aE\xdf\xa3"
    )


def read(path: Path, key: str | None) -> Array:
    """All frames (N, h, w), uint8 or uint16.

    Raises:
        DataError: The film is in colour.
    """
    return stack_frames(stream(path, key), path)


def stream(path: Path, key: str | None) -> Iterator[Array]:
    """Frame after frame (h, w)."""
    av = import_optional("av", "video", str(path))
    with path.open("rb") as file, av.open(file) as container:
        if not container.streams.video:
            raise DataError(f"{path}: a film without pictures")
        context = container.streams.video[0].codec_context
        if context is None or not context.width:
            raise DataError(
                f"{path}: a film of a codec that FFmpeg does not know, such as Y16; record it as FFV1 or raw gray16le "
                "in Matroska, or read the samples with data.raw"
            )
        check_size(path, 2 * context.width * context.height, path.stat().st_size, compressed=True)
        for frame in container.decode(video=0):
            deep = any(component.bits > 8 for component in frame.format.components)
            grey = "gray16le" if deep else "gray"
            if len(frame.format.components) == 1 and not frame.format.has_palette:
                yield frame.to_ndarray(format=frame.format.name if frame.format.name in DEEP_GREY else grey)
                continue
            if frame.format.name in PACKED_SIXTEEN:
                raise DataError(
                    f"{path}: 16 bits a sample without a name, which FFmpeg takes for colours ({frame.format.name}). "
                    "If they are grey counts, write them as FFV1 or TIFF, or read them with data.raw"
                )
            is_yuv = frame.format.name.startswith(("yuv4", "yuvj4")) and not deep
            pixels = None if is_yuv else frame.to_ndarray(format="rgb48le" if deep else "rgb24")
            if (_colour(frame) if pixels is None else _channel_difference(pixels)) <= GREY_TOLERANCE:
                yield frame.to_ndarray(format=grey)
            else:
                yield to_grey(frame.to_ndarray(format="rgb24") if pixels is None else pixels, path)


def _colour(frame: Any) -> float:
    """Largest difference of the channels of an 8-bit YUV frame, share of the range, from its colour planes (BT.601)."""
    blue, red = (
        np.frombuffer(plane, np.uint8).reshape(plane.height, plane.line_size)[:, : plane.width]
        - np.float32(128)
        for plane in frame.planes[1:3]
    )
    channels = 1.402 * red, -0.344 * blue - 0.714 * red, 1.772 * blue
    return max(float(np.abs(a - b).max()) for a, b in itertools.combinations(channels, 2)) / 255


def _channel_difference(pixels: Array) -> float:
    """Largest difference of the channels (h, w, 3) of a pixel, as a share of the range."""
    channels = (pixels[..., channel].astype(np.int32) for channel in range(3))
    most = max(int(np.abs(a - b).max()) for a, b in itertools.combinations(channels, 2))
    return most / int(np.iinfo(pixels.dtype).max)
