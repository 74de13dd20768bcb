"""Frames as pictures that a browser shows, or saves."""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Any

import numpy as np
from PIL import Image

from deepir.arrays.samples import as_float32
from deepir.io.output.palettes import colour_table
from deepir.io.output.tone_mapping import PERCENTILE, TONE_MAPPINGS, apply_palette, display_limits, stretch
from deepir.io.output.write import save_tiff

Array = np.ndarray[Any, Any]
Limits = tuple[float, float]

JPEG_QUALITY = 90  # of 100: 150 kB for 640 x 480 px in colour


def jpeg(frame: Array, palette: str, tones: str) -> tuple[bytes, Limits | None]:
    """A frame (h, w) to look at, and the values that the palette begins and ends with, if all pixels share them."""
    values = as_float32(frame)
    limits = display_limits(values) if tones == PERCENTILE else None
    shades = stretch(values, *limits) if limits else TONE_MAPPINGS[tones](values)
    return _encoded(apply_palette(shades, palette), "JPEG", quality=JPEG_QUALITY, subsampling=0), limits


def png(frame: Array, palette: str, tones: str) -> bytes:
    """A frame (h, w) in a palette and tones, without loss."""
    return _encoded(apply_palette(TONE_MAPPINGS[tones](frame), palette), "PNG")


def tiff(frame: Array, metadata: Mapping[str, Any]) -> bytes:
    """The values of a frame (h, w), float32."""
    file = io.BytesIO()
    save_tiff(file, frame, metadata)
    return file.getvalue()


def swatch(palette: str) -> bytes:
    """The colours of a palette side by side, 256 x 1 px, PNG."""
    return _encoded(colour_table(palette)[None], "PNG")


def _encoded(picture: Array, form: str, **options: int) -> bytes:
    file = io.BytesIO()
    Image.fromarray(picture).save(file, form, **options)
    return file.getvalue()
