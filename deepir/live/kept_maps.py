"""Maps of a camera from one day to the next, in the user's folder for data."""

from __future__ import annotations

import re
import time
from pathlib import Path

from platformdirs import user_data_path

from deepir.calibration import CorrectionMaps, read_maps
from deepir.errors import DataError


class KeptMaps:
    """The maps that are kept for a camera.

    Args:
        identity: What identifies it.
    """

    def __init__(self, identity: str) -> None:
        name = re.sub(r"[^A-Za-z0-9.-]+", "_", identity).strip("._")
        self.path: Path = user_data_path("deepir") / "cameras" / f"{name}.npz"

    @property
    def date(self) -> str:
        """Local date and time at which they were kept."""
        return time.strftime("%Y-%m-%d %H:%M", time.localtime(self.path.stat().st_mtime))

    def read(self, shape: tuple[int, ...]) -> CorrectionMaps | None:
        """Those of frames of a shape (h, w); None if there are none, they are damaged, or of another mode's frames."""
        try:
            maps = read_maps(self.path)
        except (DataError, OSError):
            return None
        return maps if maps.gain.shape == shape else None

    def save(self, maps: CorrectionMaps) -> None:
        """Keep maps in place of those before.

        Raises:
            DataError: The folder cannot be written.
        """
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            maps.save(self.path)
        except OSError as error:
            raise DataError(f"{self.path}: the maps cannot be kept: {error}") from None
