"""What a driver of a camera is."""

from __future__ import annotations

from types import TracebackType
from typing import Any, ClassVar, Self

import numpy as np

Array = np.ndarray[Any, Any]


class Camera:
    """A camera that gives raw frames; opened by its constructor, whose arguments are what a user may set.

    The constructor raises `DataError` where there is no camera, it is busy or may not be opened, or its library is not
    installed.
    """

    #: What the driver did about the camera's own correction, or what is left to do, in one line.
    correction: ClassVar[str] = ""

    def read(self) -> Array | None:
        """The newest frame (h, w) of whole numbers or float32, or None if there is none yet; it does not wait.

        Raises `DataError` where the camera is gone.
        """
        raise NotImplementedError

    def close(self) -> None:
        """Give the camera back as it was found."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
