"""Text in a picture."""

from __future__ import annotations

import functools
from typing import Any

from PIL import ImageDraw, ImageFont

Point = tuple[float, float]
TITLE_SIZE, LABEL_SIZE = 16, 13  # px
INK = "black"


@functools.cache
def _font(size: int) -> Any:
    return ImageFont.load_default(size)


def write_text(draw: ImageDraw.ImageDraw, at: Point, text: str, anchor: str, size: int = LABEL_SIZE) -> None:
    """Write at a point, px; `anchor` is Pillow's, such as `mt`: the middle of the top."""
    draw.text(at, text, fill=INK, font=_font(size), anchor=anchor)


def text_width(text: str, size: int = LABEL_SIZE) -> float:
    """Width of a text, px."""
    return float(_font(size).getlength(text))
