"""Requests of viewers, and the responses: the newest frame in the palette they ask for, and the status."""

from __future__ import annotations

from collections.abc import Collection
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from deepir.io.output.palettes import PALETTES
from deepir.io.output.tone_mapping import TONE_MAPPINGS
from deepir.io.output.write import to_json_types
from deepir.io.radiometry import unit_metadata
from deepir.live.page.pictures import jpeg
from deepir.live.page.session import Command, Session
from deepir.live.playback import CorrectedFrame


def _one_of(names: Collection[str]) -> AfterValidator:
    def check(name: str) -> str:
        if name not in names:
            raise ValueError(f"one of {', '.join(names)}")
        return name

    return AfterValidator(check)


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
    palette: Annotated[str, _one_of(PALETTES)]
    tones: Annotated[str, _one_of(TONE_MAPPINGS)]
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
    status["unit"] = _unit(newest, session)
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


def _unit(frame: CorrectedFrame, session: Session) -> str:
    """Of the values; empty where it is not known."""
    whole = "counts" if frame.raw.dtype.kind in "iu" else ""
    return str(unit_metadata(session.radiometry).get("unit", whole))


def _kelvin(values: Any, session: Session) -> Any:
    """The temperature of values, if it is known."""
    return session.radiometry.kelvin(np.asarray(values)) if session.radiometry else None
