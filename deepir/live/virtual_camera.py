"""Corrected frames as a camera that video programs see. Needs the extra `virtual-camera`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from deepir.errors import DataError
from deepir.io.extras import import_optional
from deepir.io.output.tone_mapping import TONE_MAPPINGS, apply_palette

if TYPE_CHECKING:
    from deepir.live.playback import CorrectedFrame

NO_DEVICE = (
    "no virtual camera: {}. On Linux load its driver: sudo modprobe v4l2loopback; on Windows and macOS install "
    "OBS Studio and start its virtual camera once"
)


@contextmanager
def virtual_camera(rate: float, palette: str, tones: str) -> Iterator[Callable[[CorrectedFrame], None]]:
    """A context with a function that shows corrected frames as a camera; the camera begins with the first one.

    Args:
        rate: Frames a second that it announces.
        palette: Of the pictures.
        tones: Tone mapping.

    Raises:
        DataError: pyvirtualcam, or a driver for it, is not installed.
    """
    library = import_optional("pyvirtualcam", "virtual-camera", "--virtual-camera")
    camera: Any = None

    def show(frame: CorrectedFrame) -> None:
        nonlocal camera
        shown = apply_palette(TONE_MAPPINGS[tones](frame.corrected), palette)
        if shown.ndim == 2:
            shown = np.repeat(shown[..., None], 3, axis=2)
        height, width = (side - side % 2 for side in shown.shape[:2])  # drivers want even sides
        if camera is None:
            try:
                camera = library.Camera(width=width, height=height, fps=rate)
            except RuntimeError as error:
                raise DataError(f"--virtual-camera: {NO_DEVICE.format(error)}") from None
        camera.send(np.ascontiguousarray(shown[:height, :width]))

    try:
        yield show
    finally:
        if camera is not None:
            camera.close()
