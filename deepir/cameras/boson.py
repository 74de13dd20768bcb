"""FLIR's Boson; its automatic shutter is disabled during a capture."""

from __future__ import annotations

import warnings

from deepir.cameras.camera import Array, Camera
from deepir.errors import DataError
from deepir.io.guards import import_optional
from deepir.registry import register


@register("camera", "boson")
class Boson(Camera):
    """FLIR's Boson by flirpy: its automatic shutter is held while it is open, and set back.

    Args:
        number: Number of its /dev/video; None: the first Boson.
        port: Its serial port; None: found by its USB identifier.
    """

    correction = "the Boson's automatic shutter is held until the burst is taken"

    def __init__(self, *, number: int | None = None, port: str | None = None) -> None:
        module = import_optional("flirpy.camera.boson", "boson", "camera 'boson'")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # flirpy warns of what is raised here
                self.camera = module.Boson(port)
                if self.camera.conn is None:
                    raise OSError("it does not answer on any serial port")
                self.camera.setup_video(number)
                self.identity = f"boson {self.camera.get_camera_serial()}"
                self.before = self.camera.get_ffc_mode()
                self.camera.set_ffc_manual()
        except Exception as error:  # serial ports, OpenCV and flirpy raise anything
            raise DataError(f"camera 'boson': cannot be opened: {error}") from None
        self.automatic = module.FLR_BOSON_AUTO_FFC

    def read(self) -> Array | None:
        """The next frame (h, w); the driver waits for it."""
        frame: Array | None = self.camera.grab()
        return frame

    def close(self) -> None:
        """Restore the automatic shutter, if it was on, and close the camera."""
        if self.before == self.automatic:
            self.camera.set_ffc_auto()
        self.camera.close()
