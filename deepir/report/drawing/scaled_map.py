"""A map with its colour scale."""

from __future__ import annotations

from typing import Any

import numpy as np
from PIL import Image, ImageDraw

from deepir.io.output.palettes import DEVIATIONS, colour_table
from deepir.io.output.tone_mapping import display_limits, stretch
from deepir.report.drawing.text import INK, TITLE_SIZE, write_text
from deepir.report.drawing.ticks import labels, linear_ticks, log_ticks

Array = np.ndarray[Any, Any]
TITLE_HEIGHT = 32  # px
MARGIN = 10  # px
BAR, SCALE = 16, 90  # px: width of the colour bar, and of it with its space and its numbers
MISSING_COLOUR = (176, 196, 222)  # of what is not finite
LOG_SCALE_RATIO = 30.0  # largest over smallest deviation from which their scale is logarithmic


def map_height(shape: tuple[int, ...], width: int, beside: int = SCALE) -> int:
    """Height of the picture of a map (h, w) that is `width` px wide, with its scale beside the map."""
    return TITLE_HEIGHT + MARGIN + round((width - beside - 2 * MARGIN) * shape[0] / shape[1])


def draw_map(
    image: Array, title: str, palette: str, size: tuple[int, int], centre: float | None = None
) -> Image.Image:
    """A map (h, w) in a picture of `size` (width, height), px; its scale is symmetric about a given centre.

    Standard deviations that differ much have a logarithmic scale; what is not finite has a colour of its own.
    """
    image = image.astype(float)
    low, high = _limits(image, centre)
    log = palette == DEVIATIONS and high > LOG_SCALE_RATIO * low > 0
    ticks = log_ticks(low, high) if log else linear_ticks(low, high)
    if log:
        image, low, high = np.log(np.fmax(image, low)), np.log(low), np.log(high)
    table = colour_table(palette)
    colours = table[np.round(255 * stretch(image, low, high)).astype(np.uint8)]
    colours[~np.isfinite(image)] = MISSING_COLOUR
    picture, bar, height = _placed(colours, title, size, SCALE)
    top, draw = TITLE_HEIGHT, ImageDraw.Draw(picture)
    picture.paste(Image.fromarray(table[::-1, None]).resize((BAR, height)), (bar, top))
    draw.rectangle((bar, top, bar + BAR, top + height), outline=INK)
    places = (np.log(ticks) if log else np.asarray(ticks)) - low
    for place, label in zip(places / (high - low), labels(ticks), strict=True):
        y = round(top + height * (1 - place))
        draw.line((bar + BAR, y, bar + BAR + 4, y), fill=INK)
        write_text(draw, (bar + BAR + 7, y), label, "lm")
    return picture


def draw_colours(colours: Array, title: str, size: tuple[int, int]) -> Image.Image:
    """Colours (h, w, 3), uint8, in a picture of `size` (width, height), px."""
    return _placed(colours, title, size)[0]


def _placed(
    colours: Array, title: str, size: tuple[int, int], beside: int = 0
) -> tuple[Image.Image, int, int]:
    """Colours with a title, and `beside` px free at their right: the picture, where these begin, the map's height."""
    room = size[0] - beside - 2 * MARGIN, size[1] - TITLE_HEIGHT - MARGIN
    scale = min(room[0] / colours.shape[1], room[1] / colours.shape[0])
    height, width = (max(round(scale * each), 1) for each in colours.shape[:2])
    left = MARGIN + (room[0] - width) // 2
    picture = Image.new("RGB", size, "white")
    picture.paste(enlarged(colours, (width, height)), (left, TITLE_HEIGHT))
    middle = left + width / 2, TITLE_HEIGHT - 8
    write_text(ImageDraw.Draw(picture), middle, title, "mb", TITLE_SIZE)
    return picture, left + width + MARGIN, height


def enlarged(colours: Array, size: tuple[int, int]) -> Image.Image:
    """Colours (h, w, 3) at another size (width, height), each pixel a square; smaller ones are means."""
    picture = Image.fromarray(colours)
    times = -(-size[0] // picture.width)
    whole = picture.resize((times * picture.width, times * picture.height), Image.Resampling.NEAREST)
    return whole.resize(size, Image.Resampling.BOX)


def _limits(image: Array, centre: float | None) -> tuple[float, float]:
    low, high = display_limits(image)
    if low == high and (finite := image[np.isfinite(image)]).size:  # all but a few are alike
        low, high = float(finite.min()), float(finite.max())
    if centre is not None:
        reach = max(high - centre, centre - low, 1e-6)
        return centre - reach, centre + reach
    return low, high if high > low else low + 1
