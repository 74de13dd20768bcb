"""Vector graphics of reports: figures with axes, and maps with a scale."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from deepir.arrays import Array
from deepir.io.output import atomic_file
from deepir.io.tone_mapping import DEVIATIONS, colour_table, display_limits, stretch

Point = tuple[float, float]
TITLE_SIZE, LABEL_SIZE = 16, 13  # px
INK = "black"
STEPS = (1, 2, 5, 10)  # between ticks, times a power of ten
MAX_DECIMALS = 5  # of a label; beyond, and from a million on, it has an exponent
COMPRESSION = 3  # of zlib: a third of the time of the default, for a tenth more
LEFT, BOTTOM = 70, 56  # px for the numbers and the name of a scale
SMOOTHING = 4  # lines are drawn that many times as large, and reduced
COLOURS = ("#1f77b4", "#ff7f0e", "#2ca02c", "#d62728", "#9467bd", "#8c564b", "#e377c2", "#7f7f7f")
GREY = "#808080"
TITLE_HEIGHT = 32  # px
MARGIN = 10  # px
BAR, SCALE = 16, 90  # px: width of the colour bar, and of it with its space and its numbers
MISSING_COLOUR = (176, 196, 222)  # of what is not finite
LOG_SCALE_RATIO = 30.0  # largest over smallest deviation from which their scale is logarithmic


@functools.cache
def _font(size: int) -> Any:
    return ImageFont.load_default(size)


def write_text(draw: ImageDraw.ImageDraw, at: Point, text: str, anchor: str, size: int = LABEL_SIZE) -> None:
    """Write at a point, px; `anchor` is Pillow's, such as `mt`: the middle of the top."""
    draw.text(at, text, fill=INK, font=_font(size), anchor=anchor)


def linear_ticks(low: float, high: float, most: int = 7) -> list[float]:
    """At most `most` round numbers at equal steps in [low, high]."""
    if not 0 < (span := high - low) < math.inf:
        return []
    power = 10.0 ** math.floor(math.log10(span / most))
    step = next(each * power for each in STEPS if each * power * most >= span * (1 - 1e-9))
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [k * step for k in range(first, last + 1)][:most]


def log_ticks(low: float, high: float) -> list[float]:
    """Powers of ten in [low, high], both positive; with their doubles and fivefolds where they are few."""
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    for factors in ((1,), (1, 2, 5)):
        found = [f * 10.0**k for k in powers for f in factors if low * 0.999 <= f * 10.0**k <= high * 1.001]
        if len(found) > 2:
            return found
    return found if len(found) > 1 else linear_ticks(low, high)


def labels(ticks: list[float]) -> list[str]:
    """The numbers as text, with as many decimals as make them different."""
    if not ticks:
        return []
    steps = [b - a for a, b in itertools.pairwise(ticks)] or [abs(ticks[0]) or 1.0]
    decimals = max(0, -math.floor(math.log10(min(steps)) + 1e-9))
    if max(steps) > 1.5 * min(steps):  # a logarithmic scale
        return [f"{each:g}" for each in ticks]
    if decimals > MAX_DECIMALS or max(map(abs, ticks)) >= 1e6:
        return [f"{each:.3g}" for each in ticks]
    return [f"{each:.{decimals}f}" for each in ticks]


class Scale(NamedTuple):
    """Values from `low` to `high`, along an axis or a colour bar."""

    low: float
    high: float
    log: bool = False

    def share(self, values: Sequence[float] | Array) -> Array:
        """Places of values: 0 at `low`, 1 at `high`."""
        low, high, at = self.low, self.high, np.asarray(values, float)
        if self.log:
            low, high, at = math.log(low), math.log(high), np.log(at)
        return np.asarray((at - low) / (high - low))

    def ticks(self) -> Iterator[tuple[float, str]]:
        """The places of round numbers, and the numbers."""
        found = (log_ticks if self.log else linear_ticks)(min(self[:2]), max(self[:2]))
        return zip(self.share(found).tolist(), labels(found), strict=True)


def write_figure(path: Path, rows: Sequence[Sequence[Image.Image]]) -> None:
    """Write rows of pictures as PNG."""
    with atomic_file(path) as part:
        composed(rows).save(part, format="PNG", compress_level=COMPRESSION)


def composed(rows: Sequence[Sequence[Image.Image]]) -> Image.Image:
    """Rows of pictures as one; those of a row are equally high."""
    size = max(sum(each.width for each in row) for row in rows), sum(row[0].height for row in rows)
    whole, top = Image.new("RGB", size, "white"), 0
    for row in rows:
        left = 0
        for each in row:
            whole.paste(each, (left, top))
            left += each.width
        top += row[0].height
    return whole


class Axes:
    """Axes in a picture, px.

    Args:
        size: Width and height of the picture.
        title: Above it.
        x: From left to right.
        y: From bottom to top.
        name: Below x.
        square: A pixel of x is as long as one of y.
    """

    def __init__(
        self, size: tuple[int, int], title: str, x: Scale, y: Scale, name: str = "", *, square: bool = False
    ) -> None:
        self.size, self.title, self.x, self.y, self.name = size, title, x, y, name
        width, height = size[0] - LEFT - 2 * MARGIN, size[1] - TITLE_HEIGHT - BOTTOM
        if square:
            width = height = min(width, height)
        self.width, self.height = width, height
        self.left = LEFT + (size[0] - LEFT - 2 * MARGIN - width) // 2
        self.inside = Image.new("RGB", (SMOOTHING * width, SMOOTHING * height), "white")
        self.draw = ImageDraw.Draw(self.inside)
        self.legend: list[tuple[str, str]] = []

    def image(self, colours: Array, extent: tuple[float, float, float, float]) -> None:
        """Colours (h, w, 3), uint8, from `extent`: left, right, bottom, top."""
        (left, right), (bottom, top) = self._across(extent[:2]), self._up(extent[2:])
        size = round(right - left), round(bottom - top)
        self.inside.paste(enlarged(colours, size), (round(left), round(top)))

    def line(self, x: Array, y: Array, colour: str, name: str = "", *, dots: bool = False) -> None:
        """A line through points, with dots on them if wanted; a name is for the legend."""
        points = list(zip(self._across(x).tolist(), self._up(y).tolist(), strict=True))
        if len(points) > 1:
            self.draw.line(points, colour, round(1.6 * SMOOTHING), "curve")
        if dots or len(points) == 1:
            self.points(x, y, colour)
        if name:
            self.legend.append((name, colour))

    def points(self, x: Array, y: Array, colour: str, radius: float = 2.5) -> None:
        """A dot at each point."""
        for point in zip(self._across(x).tolist(), self._up(y).tolist(), strict=True):
            self.draw.circle(point, radius * SMOOTHING, colour)

    def level(self, y: float) -> None:
        """A dotted line across."""
        at = float(self._up([y])[0])
        for start in range(0, self.inside.width, 6 * SMOOTHING):
            self.draw.line((start, at, start + 2 * SMOOTHING, at), GREY, SMOOTHING)

    def picture(self) -> Image.Image:
        """The picture, with scales, title and legend."""
        picture = Image.new("RGB", self.size, "white")
        picture.paste(self.inside.reduce(SMOOTHING), (self.left, TITLE_HEIGHT))
        draw = ImageDraw.Draw(picture)
        right, bottom, middle = self.left + self.width, TITLE_HEIGHT + self.height, self.left + self.width / 2
        draw.rectangle((self.left, TITLE_HEIGHT, right, bottom), outline=INK)
        write_text(draw, (middle, TITLE_HEIGHT - 8), self.title, "mb", TITLE_SIZE)
        write_text(draw, (middle, bottom + 28), self.name, "mt")
        for share, label in self.x.ticks():
            at = self.left + share * self.width
            draw.line((at, bottom, at, bottom + 4), INK)
            write_text(draw, (at, bottom + 8), label, "mt")
        for share, label in self.y.ticks():
            at = TITLE_HEIGHT + (1 - share) * self.height
            draw.line((self.left - 4, at, self.left, at), INK)
            write_text(draw, (self.left - 8, at), label, "rm")
        self._write_legend(draw, right - 10)
        return picture

    def _write_legend(self, draw: ImageDraw.ImageDraw, right: int) -> None:
        if not self.legend:
            return
        row = LABEL_SIZE + 6
        left = right - max(_font(LABEL_SIZE).getlength(name) for name, _ in self.legend) - 40
        top = TITLE_HEIGHT + 10
        draw.rectangle((left, top, right, top + row * len(self.legend) + 6), "white", "lightgrey")
        for k, (name, colour) in enumerate(self.legend):
            y = top + 3 + row * (k + 0.5)
            draw.line((left + 7, y, left + 27, y), colour, 2)
            write_text(draw, (left + 33, y), name, "lm")

    def _across(self, x: Sequence[float] | Array) -> Array:
        return self.x.share(x) * self.inside.width

    def _up(self, y: Sequence[float] | Array) -> Array:
        return (1 - self.y.share(y)) * self.inside.height


def map_height(shape: tuple[int, ...], width: int, beside: int = SCALE) -> int:
    """Height of the picture of a map (h, w) that is `width` px wide, with its scale beside the map."""
    return TITLE_HEIGHT + MARGIN + round((width - beside - 2 * MARGIN) * shape[0] / shape[1])


def draw_map(image: Array, title: str, palette: str, size: tuple[int, int], centre: float | None = None) -> Image.Image:
    """A map (h, w) in a picture of `size` (width, height), px; its scale is symmetric about a given centre.

    Standard deviations that differ much have a logarithmic scale; what is not finite has a colour of its own.
    """
    image = image.astype(float)
    low, high = _limits(image, centre)
    scale = Scale(low, high, log=palette == DEVIATIONS and high > LOG_SCALE_RATIO * low > 0)
    if scale.log:
        image, low, high = np.log(np.fmax(image, low)), np.log(low), np.log(high)
    table = colour_table(palette)
    colours = table[np.round(255 * stretch(image, low, high)).astype(np.uint8)]
    colours[~np.isfinite(image)] = MISSING_COLOUR
    picture, bar, height = _placed(colours, title, size, SCALE)
    top, draw = TITLE_HEIGHT, ImageDraw.Draw(picture)
    picture.paste(Image.fromarray(table[::-1, None]).resize((BAR, height)), (bar, top))
    draw.rectangle((bar, top, bar + BAR, top + height), outline=INK)
    for share, label in scale.ticks():
        y = round(top + height * (1 - share))
        draw.line((bar + BAR, y, bar + BAR + 4, y), fill=INK)
        write_text(draw, (bar + BAR + 7, y), label, "lm")
    return picture


def draw_colours(colours: Array, title: str, size: tuple[int, int]) -> Image.Image:
    """Colours (h, w, 3), uint8, in a picture of `size` (width, height), px."""
    return _placed(colours, title, size)[0]


def _placed(colours: Array, title: str, size: tuple[int, int], beside: int = 0) -> tuple[Image.Image, int, int]:
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
