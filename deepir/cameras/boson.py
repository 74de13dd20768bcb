"""FLIR's Boson, its automatic shutter held by the serial port."""

from __future__ import annotations

import warnings

from deepir.cameras.camera import Array, Camera
from deepir.errors import DataError
from deepir.io.extras import import_optional
from deepir.registry import register


@register("camera", "boson")
class Boson(Camera):
    """FLIR's Boson by flirpy: its automatic shutter is held while it is open, and set back.

    number: of its /dev/video, found by itself unless given. port: its serial port, likewise.
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
                self.before = self.camera.get_ffc_mode()
                self.camera.set_ffc_manual()
        except Exception as error:  # serial ports, OpenCV and flirpy raise anything
            raise DataError(f"camera 'boson': cannot be opened: {error}") from None
        self.automatic = module.FLR_BOSON_AUTO_FFC

    def read(self) -> Array | None:
        """The frame that is taken next: the Boson's driver waits for it."""
        frame: Array | None = self.camera.grab()
        return frame

    def close(self) -> None:
        """Let the shutter close by itself again, if it did before."""
        if self.before == self.automatic:
            self.camera.set_ffc_auto()
        self.camera.close()
