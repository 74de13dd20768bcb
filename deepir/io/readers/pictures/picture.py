"""Plain 8-bit pictures that Pillow opens: JPEG and BMP."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from deepir.errors import DataError
from deepir.io.containers import jpeg
from deepir.io.guards import LOSSY_TOLERANCE, check_size, to_grey
from deepir.io.readers import Array

GENERIC = True
SUFFIXES = (".jpg", ".jpeg", ".bmp")
PILLOW_FORMATS = ("JPEG", "BMP")  # decoders that Pillow may use
MIN_PLANE_BYTES = 2 * 80 * 60  # length of the smallest raw plane beside a picture


def sniff(head: bytes, path: Path) -> bool:
    """The signatures of JPEG and BMP."""
    return head.startswith((b"\xff\xd8\xff", b"BM"))


def read(path: Path, key: str | None) -> Array:
    """The picture (h, w), uint8.

    Raises:
        DataError: It is in colour, or only the preview of raw data.
    """
    _refuse_preview(path)
    with Image.open(path, formats=PILLOW_FORMATS) as image:
        check_size(path, 3 * image.width * image.height, path.stat().st_size, compressed=True)
        return to_grey(
            np.asarray(image.convert("RGB")), path, tolerance=LOSSY_TOLERANCE if image.format == "JPEG" else 0
        )


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
