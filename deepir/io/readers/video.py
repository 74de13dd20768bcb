"""Grey videos: AVI, MP4, Matroska, MOV. Needs the extra `video`. Most are 8 bits, stretched by the camera."""

from __future__ import annotations

import itertools
import math
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from deepir.errors import DataError
from deepir.io.guards import LOSSY_TOLERANCE, check_size, import_optional, masked, to_grey, warn_once
from deepir.io.readers import Array, Reader

#: Formats of grey films of 9 to 16 bits that keep their counts; in others they are stretched to 16.
DEEP_GREY = tuple(f"gray{bits}le" for bits in (9, 10, 12, 14, 16))
#: What uncompressed AVI and MOV of 16 bits are taken for, whatever they hold.
PACKED_SIXTEEN = ("rgb555le", "rgb555be", "rgb565le", "rgb565be", "bgr555le", "bgr565le")
AVI_HEAD_BYTES = 2**14  # within which an AVI says what its film is
LIMITED_RANGE = (12, 239)  # luma for black and white, 16 and 235, with what a lossy codec adds
#: Grey level of each luma of that range, as FFmpeg's scaler gives it; by this table it takes a fiftieth of the time.
STRETCHED = np.clip(np.rint((np.arange(256) - 16) * 255 / 219), 0, 255).astype(np.uint8)
MAX_DIFFERENCE = 3.174  # of two channels, of colour planes that differ by one from grey (BT.601)
FULL_RANGE = 2  # FFmpeg's AVCOL_RANGE_JPEG: luma from 0 to 255
MAX_OVERSHOOT = 0.002  # share of the samples beyond it in a film of that range
MIN_SHARE_OF_ANNOUNCED = 0.95  # of the frames, as recorders count those that they drop


class Video(Reader):
    """Films that FFmpeg decodes."""

    name = "video"
    suffixes = (".avi", ".mp4", ".mkv", ".mov")
    generic = True

    def sniff(self, head: bytes, path: Path) -> bool:
        """The signatures of AVI, MP4 and MOV, and Matroska."""
        return head[4:8] == b"ftyp" or (head[:4], head[8:12]) == (b"RIFF", b"AVI ") or head[:4] == b"\x1aE\xdf\xa3"

    def stream(self, path: Path, key: str | None) -> Iterator[Array]:
        """Frame after frame (h, w)."""
        with _opened(path) as container:
            if not container.streams.video:
                raise DataError(f"{path}: a film without pictures")
            films = container.streams.video
            # The first grey one, as of a thermal camera beside another.
            greys = (
                each for each in films if each.codec_context and str(each.codec_context.pix_fmt).startswith("gray")
            )
            film = next(greys, films[0])
            context = film.codec_context
            if context is None and (size := _y16_size(path)) is not None:
                check_size(path, 2 * math.prod(size), path.stat().st_size)
                for packet in container.demux(film):
                    if packet.size:
                        yield np.frombuffer(packet, "<u2").reshape(size)
                return
            if context is None or not context.width:
                raise DataError(
                    f"{path}: a film of a codec that FFmpeg does not know; record it as FFV1 or raw gray16le "
                    "in Matroska, or read the samples with data.raw"
                )
            check_size(path, 2 * context.width * context.height, path.stat().st_size, compressed=True)
            as_stored: bool | None = None  # whether luma are the counts, and not 16 to 235 for 0 to 255
            for frame in _counted(container, film, path):
                deep = any(component.bits > 8 for component in frame.format.components)
                grey = "gray16le" if deep else "gray"
                name = frame.format.name
                if len(frame.format.components) == 1 and not frame.format.has_palette:
                    exact = name.removesuffix("be").removesuffix("le") + "le"
                    yield frame.to_ndarray(format=exact if exact in DEEP_GREY else grey)
                    continue
                if name in PACKED_SIXTEEN:
                    raise DataError(
                        f"{path}: 16 bits a sample without a name, which FFmpeg takes for colours ({name}). "
                        "If they are grey counts, write them as FFV1 or TIFF, or read them with data.raw"
                    )
                is_yuv = name.startswith(("yuv4", "yuvj4"))
                if is_yuv and as_stored is None:
                    as_stored = deep or _exceeds_limited_range(frame)
                counts = _luma(frame) if is_yuv and as_stored else _stretched(frame, grey)
                if is_yuv and not deep and _colour(frame) <= LOSSY_TOLERANCE:
                    yield counts
                    continue
                pixels = frame.to_ndarray(format="rgb48le" if deep else "rgb24")
                coloured = np.ma.getmaskarray(to_grey(pixels, path, tolerance=LOSSY_TOLERANCE))
                yield masked(counts, coloured)


def _counted(container: Any, film: Any, path: Path) -> Iterator[Any]:
    """The decoded frames of a film; a warning at the end if it lacks many of those that its header announces."""
    count, announced = 0, film.frames  # 0: not announced
    for frame in container.decode(film):
        count += 1
        yield frame
    if count < MIN_SHARE_OF_ANNOUNCED * announced:
        warn_once(f"{path}: {count} of the {announced} frames that its header announces: cut off, or damaged")


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """The film as PyAV opens it."""
    av = import_optional("av", "video", str(path))
    try:
        with path.open("rb") as file, av.open(file) as container:
            yield container
    except av.error.MemoryError as error:  # of a size that FFmpeg never allocates, however much there is
        raise DataError(f"{path}: damaged: it declares a part that is too large for FFmpeg") from error


def _y16_size(path: Path) -> tuple[int, int] | None:
    """Height and width of an AVI of uncompressed 16-bit grey (Y16), from its BITMAPINFOHEADER; None: something else."""
    with path.open("rb") as file:
        head = file.read(AVI_HEAD_BYTES)
    at = head.find(b"strf") + 8
    if at < 8 or len(head) < at + 20:
        return None
    width, height, _, _, codec = struct.unpack_from("<iiHH4s", head, at + 4)
    return (abs(height), width) if codec[:3] == b"Y16" and width > 0 else None


def _luma(frame: Any) -> Array:
    """The counts (h, w) of the luma plane of a YUV frame, as stored."""
    plane, name = frame.planes[0], frame.format.name
    dtype = np.dtype("u1" if frame.format.components[0].bits <= 8 else ">u2" if name.endswith("be") else "<u2")
    stored = np.frombuffer(plane, dtype).reshape(plane.height, plane.line_size // dtype.itemsize)
    return stored[:, : plane.width].astype(dtype.newbyteorder("="))


def _stretched(frame: Any, grey: str) -> Array:
    """The grey levels (h, w) of a frame, its whole range from black to white."""
    if grey == "gray" and frame.format.name.startswith("yuv4") and frame.color_range != FULL_RANGE:
        return np.asarray(STRETCHED[_luma(frame)])
    return np.asarray(frame.to_ndarray(format=grey))


def _exceeds_limited_range(frame: Any) -> bool:
    """Whether an 8-bit YUV frame without a word on its range takes all of it: grey that was encoded as it was."""
    low, high = LIMITED_RANGE
    luma = _luma(frame)
    return not frame.color_range and float(((luma < low) | (luma > high)).mean()) > MAX_OVERSHOOT


def _colour(frame: Any) -> float:
    """Largest difference of the channels of an 8-bit YUV frame, share of the range, from its colour planes (BT.601)."""
    planes = [
        np.frombuffer(plane, np.uint8).reshape(plane.height, plane.line_size)[:, : plane.width]
        for plane in frame.planes[1:3]
    ]
    most = max(abs(int(edge) - 128) for plane in planes for edge in (plane.min(), plane.max()))
    if MAX_DIFFERENCE * most <= 255 * LOSSY_TOLERANCE:  # mostly so: a bound is enough
        return MAX_DIFFERENCE * most / 255
    blue, red = (plane - np.float32(128) for plane in planes)
    channels = 1.402 * red, -0.344 * blue - 0.714 * red, 1.772 * blue
    return max(float(np.abs(a - b).max()) for a, b in itertools.combinations(channels, 2)) / 255
