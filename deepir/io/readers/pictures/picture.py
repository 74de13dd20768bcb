"""Plain 8-bit pictures that Pillow opens: JPEG and BMP."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from deepir.io.guards import check_size, to_grey
from deepir.io.readers import Array

GENERIC = True
SUFFIXES = (".jpg", ".jpeg", ".bmp")
PILLOW_FORMATS = ("JPEG", "BMP")  # decoders that Pillow may use


def sniff(head: bytes, path: Path) -> bool:
    """The signatures of JPEG and BMP."""
    return head.startswith((b"\xff\xd8\xff", b"BM"))


def read(path: Path, key: str | None) -> Array:
    """The picture (h, w), uint8.

    Raises:
        DataError: It is in colour.
    """
    with Image.open(path, formats=PILLOW_FORMATS) as image:
        check_size(path, 3 * image.width * image.height, path.stat().st_size, compressed=True)
        return to_grey(np.asarray(image.convert("RGB")), path)
