"""Cameras of commands."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from deepir.cameras.camera import Camera
from deepir.cli.terminal import notify
from deepir.config.components import make, options_schema
from deepir.config.overrides import parse_settings
from deepir.registry import lookup


@contextmanager
def open_camera(name: str, settings: Sequence[str]) -> Iterator[Camera]:
    """A context with an open camera; prints what is to be known of its built-in correction.

    Args:
        name: Of the driver.
        settings: `KEY=VALUE` of the driver.

    Raises:
        ConfigError: There is no such driver, or a setting is wrong.
        DataError: The camera cannot be opened.
    """
    options: dict[str, Any] = dict(parse_settings(settings, options_schema(lookup("camera", name, "camera"))))
    with make("camera", name, options, "camera") as camera:
        if camera.correction:
            notify(camera.correction)
        yield camera
