"""Frames of a camera of `deepir live`, and the maps that are kept for it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from deepir.cameras.camera import Camera
from deepir.cli.terminal import notify
from deepir.errors import DataError
from deepir.live import sources
from deepir.live.corrector import Corrector
from deepir.live.kept_maps import KeptMaps

Array = np.ndarray[Any, Any]


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
