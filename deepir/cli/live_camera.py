"""Cameras and recordings as sources of the command `live`, and its page."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from deepir.cameras.camera import Camera
from deepir.cli.arguments import recording_radiometry
from deepir.cli.terminal import Interrupted, Interruptible, notify
from deepir.config import Config
from deepir.config.components import make, options_schema
from deepir.config.overrides import parse_settings
from deepir.errors import DataError
from deepir.io.radiometry import unit_metadata
from deepir.live import sources
from deepir.live.corrector import Corrector
from deepir.live.page.server import serve
from deepir.live.page.views import Session
from deepir.live.recorder import KeptMaps, Recorder
from deepir.registry import lookup

Array = np.ndarray[Any, Any]


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


@contextmanager
def open_page(
    corrector: Corrector, source: str, config: Config | None, address: tuple[str, int], folder: Path
) -> Iterator[Session]:
    """A context with a page; what its session is given is shown there.

    Args:
        corrector: Of the frames.
        source: Of the frames: a file or a camera.
        config: Of the file; None for a camera.
        address: Host and port of the page.
        folder: For recordings.
    """
    radiometry = recording_radiometry(config) if config else None
    recorder = Recorder(folder, unit_metadata(radiometry))
    display = {"palette": config.output.palette, "tones": config.output.tones} if config else {}
    session = Session(corrector, recorder, title=Path(source).name, radiometry=radiometry, **display)
    with serve(session, *address) as url:
        notify(f"the frames are shown at {url}")
        try:
            yield session
        finally:
            recorder.close()
            if recorder.message:
                notify(f"{recorder.message}")


def keep_page(session: Session, ended: str) -> None:
    """Show the last frame, and why it is the last, until Ctrl-C."""
    session.end(ended)
    notify("the page stays until Ctrl-C")
    with Interruptible(), suppress(Interrupted):
        while True:
            time.sleep(1)
