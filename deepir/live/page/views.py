"""Pictures of the live page and what its viewers see."""

from __future__ import annotations

import io
import queue
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from PIL import Image
from pydantic import BaseModel, ConfigDict, Field

from deepir.arrays import Array
from deepir.arrays.samples import as_float32
from deepir.config.schema import Palette, Tones
from deepir.io.output import save_tiff, to_json_types
from deepir.io.radiometry import Radiometry, unit_metadata
from deepir.io.tone_mapping import (
    PERCENTILE,
    TONE_MAPPINGS,
    WHITE_HOT,
    apply_palette,
    colour_table,
    display_limits,
    stretch,
)
from deepir.live.corrector import Corrector
from deepir.live.recorder import Recorder
from deepir.live.sources import CorrectedFrame

Limits = tuple[float, float]


def jpeg(frame: Array, palette: str, tones: str) -> tuple[bytes, Limits | None]:
    """A frame (h, w) to look at, and the values that the palette begins and ends with, if all pixels share them."""
    values = as_float32(frame)
    limits = display_limits(values) if tones == PERCENTILE else None
    shades = stretch(values, *limits) if limits else TONE_MAPPINGS[tones](values)
    return _encoded(apply_palette(shades, palette), "JPEG", quality=90, subsampling=0), limits


def png(frame: Array, palette: str, tones: str) -> bytes:
    """A frame (h, w) in a palette and tones, without loss."""
    return _encoded(apply_palette(TONE_MAPPINGS[tones](frame), palette), "PNG")


def tiff(frame: Array, metadata: Mapping[str, Any]) -> bytes:
    """The values of a frame (h, w), float32."""
    file = io.BytesIO()
    save_tiff(file, frame, metadata)
    return file.getvalue()


def swatch(palette: str) -> bytes:
    """The colours of a palette side by side, 256 x 1 px, PNG."""
    return _encoded(colour_table(palette)[None], "PNG")


def _encoded(picture: Array, form: str, **options: int) -> bytes:
    file = io.BytesIO()
    Image.fromarray(picture).save(file, form, **options)
    return file.getvalue()


Fraction = Annotated[float, Field(ge=0, lt=1)]


class ViewerRequest(BaseModel):
    """Request of a viewer for the newest frame.

    Attributes:
        seen: Number of the last frame the viewer received; only a newer one is sent.
        palette, tones: In which the frame is shown.
        raw: Whether the raw frame is sent too.
        point: x and y of the point whose values are sent, as fractions of the width and of the height.
        command: Command to the corrector or to the recorder, if any.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    seen: int = 0
    palette: Palette
    tones: Tones
    raw: bool = False
    point: tuple[Fraction, Fraction] | None = None
    command: Command | None = None


def respond(session: Session, request: ViewerRequest) -> tuple[list[bytes], dict[str, Any]]:
    """The response to a request.

    Returns:
        JPEGs of the corrected frame and of the raw one, or none if the viewer has the newest; and the status, in JSON's
        types.
    """
    newest, recorder = session.newest, session.recorder
    status: dict[str, Any] = {
        "number": 0,
        "ended": session.ended,
        "recording": recorder.recording,
        "recorded": recorder.frames,
        "recorder": recorder.message,
    }
    if newest is None:
        return [], status
    status |= vars(newest.status) | {"state": newest.status.state, "number": newest.number}
    status |= {"rate": newest.rate, "delay": 1000 * newest.delay, "dropped": newest.dropped}
    whole = "counts" if newest.raw.dtype.kind in "iu" else ""
    status["unit"] = str(unit_metadata(session.radiometry).get("unit", whole))
    if request.point:
        status["spot"] = _spot(newest, session, *request.point)
    pictures = []
    if newest.number != request.seen:
        shown = [newest.corrected, newest.raw] if request.raw else [newest.corrected]
        made = [jpeg(each, request.palette, request.tones) for each in shown]
        pictures = [picture for picture, _ in made]
        limits = made[0][1]
        status |= {"limits": limits, "kelvin": limits and _kelvin(limits, session)}
    return pictures, to_json_types(status)


def _spot(frame: CorrectedFrame, session: Session, x: float, y: float) -> dict[str, Any]:
    """The values at a point, and the temperature if it is known."""
    height, width = frame.raw.shape
    row, column = int(y * height), int(x * width)
    raw, corrected = (each[row, column] for each in (frame.raw, frame.corrected))
    found = {"x": column, "y": row, "raw": raw, "corrected": corrected}
    return found | {"kelvin": _kelvin(corrected, session)}


def _kelvin(values: Any, session: Session) -> Any:
    """The temperature of values, if it is known."""
    return session.radiometry.kelvin(np.asarray(values)) if session.radiometry else None


Command = Literal["hold", "learn", "reset", "record", "stop"]  # of a viewer


class Session:
    """The newest frame for viewers in other threads, and their commands.

    Only the newest frame is kept, and nothing is computed until a viewer asks for it. Commands are executed
    between two frames, in the correcting thread.

    Args:
        corrector: Of the frames.
        recorder: For recordings that viewers start.
        title: Name of the recording or camera.
        radiometry: Of the frames, if known.
        palette, tones: That a viewer begins with.

    Attributes:
        newest: The newest frame; None before the first.
        ended: Why no more frames come; empty as long as they do.
    """

    def __init__(
        self,
        corrector: Corrector,
        recorder: Recorder,
        *,
        title: str = "",
        radiometry: Radiometry | None = None,
        palette: str = WHITE_HOT,
        tones: str = PERCENTILE,
    ) -> None:
        self.recorder, self.title, self.radiometry = recorder, title, radiometry
        self.palette, self.tones = palette, tones
        self.newest: CorrectedFrame | None = None
        self.ended = ""
        self._corrector = corrector
        self._commands: queue.SimpleQueue[Command] = queue.SimpleQueue()

    def show(self, frame: CorrectedFrame) -> None:
        """The next frame; executes the commands that wait."""
        self.recorder.add(frame.raw, frame.corrected)
        self.newest = frame
        while not self._commands.empty():
            match self._commands.get():
                case "hold" | "learn" as command:
                    self._corrector.hold = command == "hold"
                case "reset":
                    self._corrector.reset()
                case "record":
                    self.recorder.start()
                case "stop":
                    self.recorder.stop()

    def end(self, reason: str) -> None:
        """No more frames come."""
        self.recorder.stop()
        self.ended = reason

    def submit(self, command: Command) -> None:
        """A command of a viewer; executed with the next frame."""
        self._commands.put(command)
