"""Curves, points and pictures between two scales."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

from deepir.report.drawing.scaled_map import MARGIN, TITLE_HEIGHT, enlarged
from deepir.report.drawing.text import INK, LABEL_SIZE, TITLE_SIZE, text_width, write_text
from deepir.report.drawing.ticks import labels, linear_ticks, log_ticks

Array = np.ndarray[Any, Any]
LEFT, BOTTOM = 70, 56  # px for the numbers and the name of a scale
SMOOTHING = 4  # lines are drawn that many times as large, and reduced
COLOURS = ("#1f77b4", "#ff7f0e", "#2ca02c", "#d62728", "#9467bd", "#8c564b", "#e377c2", "#7f7f7f")
GREY = "#808080"


class Axes:
    """Axes in a picture, px.

    Args:
        size: Width and height of the picture.
        title: Above it.
        x: Limits, left and right.
        y: Limits, bottom and top.
        name: Below x.
        log: The scale of y is logarithmic.
        square: A pixel of x is as long as one of y.
    """

    def __init__(
        self,
        size: tuple[int, int],
        title: str,
        x: tuple[float, float],
        y: tuple[float, float],
        name: str = "",
        *,
        log: bool = False,
        square: bool = False,
    ) -> None:
        self.size, self.title, self.x, self.y, self.name, self.log = size, title, x, y, name, log
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
        ticks = linear_ticks(min(self.x), max(self.x))
        for place, label in zip(self._across(ticks) / SMOOTHING, labels(ticks), strict=True):
            draw.line((self.left + place, bottom, self.left + place, bottom + 4), INK)
            write_text(draw, (self.left + place, bottom + 8), label, "mt")
        ticks = (log_ticks if self.log else linear_ticks)(min(self.y), max(self.y))
        for place, label in zip(self._up(ticks) / SMOOTHING, labels(ticks), strict=True):
            draw.line((self.left - 4, TITLE_HEIGHT + place, self.left, TITLE_HEIGHT + place), INK)
            write_text(draw, (self.left - 8, TITLE_HEIGHT + place), label, "rm")
        self._write_legend(draw, right - 10)
        return picture

    def _write_legend(self, draw: ImageDraw.ImageDraw, right: int) -> None:
        if not self.legend:
            return
        row = LABEL_SIZE + 6
        left = right - max(text_width(name) for name, _ in self.legend) - 40
        top = TITLE_HEIGHT + 10
        draw.rectangle((left, top, right, top + row * len(self.legend) + 6), "white", "lightgrey")
        for k, (name, colour) in enumerate(self.legend):
            y = top + 3 + row * (k + 0.5)
            draw.line((left + 7, y, left + 27, y), colour, 2)
            write_text(draw, (left + 33, y), name, "lm")

    def _across(self, x: Sequence[float] | Array) -> Array:
        left, right = self.x
        return (np.asarray(x, float) - left) / (right - left) * self.inside.width

    def _up(self, y: Sequence[float] | Array) -> Array:
        bottom, top, values = *self.y, np.asarray(y, float)
        if self.log:
            bottom, top, values = np.log(bottom), np.log(top), np.log(values)
        return (top - values) / (top - bottom) * self.inside.height
