"""The interface of a camera driver."""

from __future__ import annotations

from types import TracebackType
from typing import Any, ClassVar, Self

import numpy as np

Array = np.ndarray[Any, Any]


class Camera:
    """A camera that gives raw frames. The constructor opens it; its arguments are the user's settings.

    The constructor raises `DataError` where the camera is missing, busy or not accessible, or its library is missing.
    """

    #: What the driver did about the camera's own correction, or what the user has to do, in one line.
    correction: ClassVar[str] = ""
    #: What identifies the camera, such as a serial number; empty if nothing does, and its maps are not kept.
    identity: str = ""

    def read(self) -> Array | None:
        """The newest frame, without waiting.

        Returns:
            (h, w), integers or float32; None if there is no new frame.

        Raises:
            DataError: The camera is gone.
        """
        raise NotImplementedError

    def close(self) -> None:
        """Close the camera and restore its former state."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
