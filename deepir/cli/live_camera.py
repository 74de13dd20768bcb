"""A camera of `deepir live`, and the maps that are kept for it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from typing import Any

import numpy as np

from deepir.cameras.camera import Camera
from deepir.cli.terminal import notify
from deepir.config.components import make, options_schema
from deepir.config.overrides import parse_settings
from deepir.errors import DataError
from deepir.live import sources
from deepir.live.corrector import Corrector
from deepir.live.kept_maps import KeptMaps
from deepir.registry import lookup

Array = np.ndarray[Any, Any]


def open_camera(name: str, settings: Sequence[str], stack: ExitStack) -> Camera:
    """Open a camera by the name of its driver; `stack` closes it."""
    options: dict[str, Any] = dict(parse_settings(settings, options_schema(lookup("camera", name, "camera"))))
    opened: Camera = stack.enter_context(make("camera", name, options, "camera"))
    if opened.correction:
        notify(opened.correction)
    return opened


def camera_frames(camera: Camera, kept: KeptMaps | None, corrector: Corrector) -> Iterable[Array]:
    """The frames (h, w) of a camera; with the first one the corrector begins with the maps that are kept, if any."""
    for number, frame in enumerate(sources.camera_frames(camera)):
        if number == 0 and kept and (maps := kept.read(frame.shape)) is not None:
            corrector.begin(maps)
            notify(f"begins with the camera's maps of {kept.date}, {kept.path}; --maps FILE takes others")
        yield frame


def keep(corrector: Corrector, kept: KeptMaps) -> None:
    """Keep the maps for the next time, if something was learned and it fits."""
    if corrector.maps is not None and corrector.status.estimates and corrector.status.correcting:
        try:
            kept.save(corrector.maps)
            notify(f"the maps are kept for the next time: {kept.path}")
        except DataError as error:
            notify(f"warning: {error}")
