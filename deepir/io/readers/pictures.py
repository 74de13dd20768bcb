"""Pictures: PNG and PGM of 8 and 16 bits, and the JPEG and BMP of 8 bits that Pillow opens."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from pathlib import Path

import imagecodecs
import numpy as np
from PIL import Image

from deepir.errors import DataError
from deepir.io.guards import LOSSY_TOLERANCE, check_size, to_grey
from deepir.io.readers import Array, Reader, jpeg

CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # samples per pixel by PNG's colour type
#: Magic number, width, height and largest value, with comments between them, and the white space before the samples.
PGM_HEADER = re.compile(rb"\s*(P[25])" + 3 * rb"(?:\s|#[^\n]*\n)+(\d+)" + rb"\s", re.DOTALL)
PGM_END = re.compile(rb"\s*\Z")
PILLOW_FORMATS = ("JPEG", "BMP")  # decoders that Pillow may use
MIN_PLANE_BYTES = 2 * 80 * 60  # length of the smallest raw plane beside a picture


class Png(Reader):
    """PNG, by libpng: it keeps all 16 bits of a colour picture, where Pillow keeps 8."""

    name = "png"
    suffixes = (".png",)
    signatures = (b"\x89PNG\r\n\x1a\n",)

    def read(self, path: Path, key: str | None) -> Array:
        """The picture (h, w), uint8 or uint16."""
        pixels = decode_png(path.read_bytes(), path)
        return pixels if pixels.ndim == 2 else to_grey(pixels, path)


def decode_png(data: bytes, path: Path) -> Array:
    """Pixels of a PNG, (h, w) or (h, w, C); `path` is for messages."""
    width, height, depth, colour = struct.unpack(">IIBB", data[16:26])
    check_size(path, width * height * CHANNELS[colour] * depth // 8, len(data), compressed=True)
    pixels: Array = imagecodecs.png_decode(data)
    return pixels


class Pgm(Reader):
    """PGM, plain (P2) or not (P5), with comments, of one or many pictures.

    Layout after https://netpbm.sourceforge.net/doc/pgm.html.
    """

    name = "pgm"
    suffixes = (".pgm",)

    def sniff(self, head: bytes, path: Path) -> bool:
        """The magic number, and white space or a comment after it."""
        return re.match(rb"P[25][\s#]", head) is not None

    def stream(self, path: Path, key: str | None) -> Iterator[Array]:
        """Picture after picture (h, w), uint8 or uint16; `DataError` where one is not whole."""
        data, at = path.read_bytes(), 0
        while PGM_END.match(data, at) is None:
            header = PGM_HEADER.match(data, at)
            if header is None:
                raise DataError(f"{path}: damaged: no picture begins at byte {at}")
            width, height, largest = (int(number) for number in header.groups()[1:])
            if not 0 < largest < 2**16:
                raise DataError(f"{path}: damaged: its largest value is {largest}")
            dtype = np.dtype("u1" if largest < 2**8 else ">u2")
            at = header.end()
            if header[1] == b"P2":
                check_size(path, 2 * width * height - 1, len(data) - at)
                words = data[at:].split(None, width * height)
                if len(words) < width * height:
                    raise DataError(f"{path}: truncated: {len(words)} samples of {width * height}")
                samples = np.array(words[: width * height], int).astype(dtype)
                at = len(data) - (len(words[-1]) if len(words) > width * height else 0)
            else:
                check_size(path, dtype.itemsize * width * height, len(data) - at)
                samples = np.frombuffer(data, dtype, width * height, at)
                at += samples.nbytes
            yield samples.reshape(height, width).astype(dtype.newbyteorder("="))


class Picture(Reader):
    """JPEG and BMP."""

    name = "picture"
    suffixes = (".jpg", ".jpeg", ".bmp")
    signatures = (jpeg.JPEG_SIGNATURE, b"BM")
    generic = True

    def read(self, path: Path, key: str | None) -> Array:
        """The picture (h, w), uint8."""
        _refuse_preview(path)
        with Image.open(path, formats=PILLOW_FORMATS) as image:
            check_size(path, 3 * image.width * image.height, path.stat().st_size, compressed=True)
            tolerance = LOSSY_TOLERANCE if image.format == "JPEG" else 0
            return to_grey(np.asarray(image.convert("RGB")), path, tolerance=tolerance)


def _refuse_preview(path: Path) -> None:
    """Refuse a JPEG whose camera has stored as much beside its picture as a raw plane takes."""
    with path.open("rb") as file:
        beside = {name: size for name, size in jpeg.camera_data(file).items() if size >= MIN_PLANE_BYTES}
    if beside:
        what = ", ".join(f"{name}: {size:,} bytes" for name, size in beside.items())
        raise DataError(
            f"{path}: a radiometric JPEG of a kind that is not known ({what}); its picture is only a preview. Export "
            "raw 16-bit TIFF with the maker's software (DJI's: DJI Thermal Analysis Tool); or save the preview as PNG"
        )
