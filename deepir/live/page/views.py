"""What a viewer asks for, and the answer: the newest frame as he wants to see it, and how it goes."""

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
from deepir.live.page.session import Order, Session
from deepir.live.playback import Moment


def _one_of(names: Collection[str]) -> AfterValidator:
    def check(name: str) -> str:
        if name not in names:
            raise ValueError(f"one of {', '.join(names)}")
        return name

    return AfterValidator(check)


Fraction = Annotated[float, Field(ge=0, lt=1)]


class Wish(BaseModel):
    """What a viewer asks for.

    Attributes:
        seen: Number of the frame that he has; he gets a newer one only.
        palette, tones: In which the frame is shown.
        raw: Whether he wants the raw frame too.
        point: x and y of the point whose values he wants, as fractions of the width and of the height.
        order: What he orders.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    seen: int = 0
    palette: Annotated[str, _one_of(PALETTES)]
    tones: Annotated[str, _one_of(TONE_MAPPINGS)]
    raw: bool = False
    point: tuple[Fraction, Fraction] | None = None
    order: Order | None = None


def answer(session: Session, wish: Wish) -> tuple[list[bytes], dict[str, Any]]:
    """The answer to a wish.

    Returns:
        JPEGs of the corrected frame and of the raw one, or none if he has the newest; and how it goes, in JSON's types.
    """
    moment, recorder = session.newest, session.recorder
    status: dict[str, Any] = {
        "number": 0,
        "ended": session.ended,
        "recording": recorder.recording,
        "recorded": recorder.frames,
        "recorder": recorder.message,
    }
    if moment is None:
        return [], status
    status |= vars(moment.status) | {"state": moment.status.state, "number": moment.number}
    status |= {"rate": moment.rate, "delay": 1000 * moment.delay, "dropped": moment.dropped}
    status["unit"] = _unit(moment, session)
    if wish.point:
        status["spot"] = _spot(moment, session, *wish.point)
    pictures = []
    if moment.number != wish.seen:
        shown = [moment.corrected, moment.raw] if wish.raw else [moment.corrected]
        made = [jpeg(frame, wish.palette, wish.tones) for frame in shown]
        pictures = [picture for picture, _ in made]
        limits = made[0][1]
        status |= {"limits": limits, "kelvin": limits and _kelvin(limits, session)}
    return pictures, to_json_types(status)


def _spot(moment: Moment, session: Session, x: float, y: float) -> dict[str, Any]:
    """The values at a point, and the temperature if it is known."""
    height, width = moment.raw.shape
    row, column = int(y * height), int(x * width)
    raw, corrected = (frame[row, column] for frame in (moment.raw, moment.corrected))
    found = {"x": column, "y": row, "raw": raw, "corrected": corrected}
    return found | {"kelvin": _kelvin(corrected, session)}


def _unit(moment: Moment, session: Session) -> str:
    """Of the values; empty where it is not known."""
    whole = "counts" if moment.raw.dtype.kind in "iu" else ""
    return str(unit_metadata(session.radiometry).get("unit", whole))


def _kelvin(values: Any, session: Session) -> Any:
    """The temperature of values, if it is known."""
    return session.radiometry.kelvin(np.asarray(values)) if session.radiometry else None
