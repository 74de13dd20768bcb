"""Video4Linux cameras with 16-bit grey frames (Y16): PureThermal, Boson and others."""

from __future__ import annotations

import errno
from pathlib import Path
from typing import Any

from deepir.cameras.camera import Array, Camera
from deepir.errors import DataError
from deepir.io.guards import import_optional
from deepir.registry import register

PIXEL_FORMAT = "gray16le"  # FFmpeg's name of 16-bit grey, little-endian (Y16)
NONBLOCKING_FLAG = "+4"  # AVFMT_FLAG_NONBLOCK, which FFmpeg does not name: Ctrl-C and silence end a read
OPEN_TIMEOUT = 10.0  # s until the first frame must have arrived


@register("camera", "v4l2")
class V4L2(Camera):
    """Any camera that Linux knows as /dev/videoN and that gives 16-bit grey (Y16), by PyAV.

    Args:
        device: Its file.
        mode: Width and height in px, where the camera has several.
    """

    correction = (
        "Video4Linux cannot switch the camera's own correction off: do it in the camera's software, or let its shutter "
        "close right before"
    )

    def __init__(self, *, device: str = "/dev/video0", mode: list[int] | None = None) -> None:
        self.identity = _identity(device)
        self.device, self.av = device, import_optional("av", "camera", device)
        if mode is not None and len(mode) != 2:
            raise ValueError(f"mode is a width and a height, not {mode}")
        options = {"pixel_format": PIXEL_FORMAT, "fflags": NONBLOCKING_FLAG}
        if mode is not None:
            options["video_size"] = "x".join(map(str, mode))
        try:
            self.container = self.av.open(device, format="v4l2", options=options, timeout=(OPEN_TIMEOUT, None))
        except (OSError, self.av.FFmpegError) as error:
            raise DataError(f"{device}: {_reason(error)}{_others(device)}") from None
        self.track = self.container.streams.video[0]
        if self.track.format.name != PIXEL_FORMAT:
            self.close()
            raise DataError(
                f"{device}: gives {self.track.format.name} and no raw 16-bit frames (Y16): a webcam?{_others(device)}"
            )

    def read(self) -> Array | None:
        """The newest frame (h, w); earlier ones are dropped."""
        newest: Array | None = None
        while True:
            try:
                frames = next(self.container.demux(self.track)).decode()
            except BlockingIOError:
                return newest
            except (OSError, StopIteration, self.av.FFmpegError) as error:
                raise DataError(f"{self.device}: the camera is gone ({error})") from None
            if not frames:
                return newest
            newest = frames[-1].to_ndarray()

    def close(self) -> None:
        """Close the device."""
        self.container.close()


def _identity(device: str) -> str:
    """Name and USB serial number of a device; empty if it has none."""
    entry = Path("/sys/class/video4linux") / Path(device).resolve().name
    usb = next((each for each in (entry / "device").resolve().parents if (each / "serial").is_file()), None)
    try:
        serial = (usb / "serial").read_text(encoding="utf-8").strip() if usb else ""
        return f"v4l2 {(entry / 'name').read_text(encoding='utf-8').strip()} {serial}" if serial else ""
    except (OSError, UnicodeDecodeError):
        return ""


def _reason(error: Any) -> str:
    """What a user can do about it."""
    known = {
        errno.ENOENT: "no such camera",
        errno.EACCES: "no permission to open it: sudo usermod -aG video $USER, and log in again",
        errno.EBUSY: "another program uses it",
        errno.EINVAL: "it does not give raw 16-bit frames (Y16) of this size",
        errno.ENOTTY: "not a camera",
    }
    return known.get(getattr(error, "errno", 0), f"cannot be opened: {error}")


def _others(device: str) -> str:
    """The cameras that there are beside this one."""
    there = sorted(str(each) for each in Path("/dev").glob("video*") if str(each) != device)
    return f"; there {'is' if len(there) == 1 else 'are'} {', '.join(there)} (device=...)" if there else ""
