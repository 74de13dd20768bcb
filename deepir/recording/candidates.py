"""The corrections that a recording may get, and the choice between them by frames that were held out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from deepir.messages import Message
from deepir.multiview.texture_flow import Displacement
from deepir.recording.held_out import HeldOutFrames
from deepir.recording.responses import refine_gain_offset

Array = np.ndarray[Any, Any]

MIN_NATS = 30.0  # by which a larger correction makes held-out frames likelier, to be chosen
#: How a camera turns whose scenes do not move along an axis, where its shading is not separated, and what to do.
ONE_WAY = (
    ("turns sideways only", "from top to bottom", "Tilt the camera too"),
    ("tilts only", "from left to right", "Turn the camera sideways too"),
)


def choose_offset(
    offsets: dict[str, Array], held_out: HeldOutFrames, correction: str
) -> tuple[tuple[str, Array], list[str]]:
    """Choose by held-out likelihood: the fine offset, the whole offset, or the fine one with the former low-order part.

    Returns:
        The name as in `CORRECTIONS` and the offset (h, w); messages.
    """
    if correction == "fine_offset":
        return (correction, offsets["fine"]), []
    whole = offsets.get("whole")
    if correction == "offset" and whole is not None:
        return (correction, whole), []
    nats = {name: _low_order_nats(held_out, each) for name, each in offsets.items()}
    better = [name for name in offsets if nats["fine"] - nats[name] > (MIN_NATS if name == "whole" else 0.0)]
    if better:
        return ("offset", offsets[min(better, key=nats.__getitem__)]), []
    return ("fine_offset", offsets["fine"]), [
        Message(
            "low-order-part-not-separated",
            "the low-order part (shading) of the fixed pattern could not be separated from the scenes and was not "
            "corrected: it is weak, or the camera moves too little",
        )
    ]


def candidate_corrections(
    masked: Array, base: tuple[str, Array], found: Sequence[Displacement], level: float, *, with_gain: bool
) -> dict[str, tuple[Array, Array]]:
    """Nested corrections (gain, offset), (h, w), by name: none, offset, registered offset, gain and offset."""
    name, offset = base
    one = np.ones_like(offset)
    gain, registered = refine_gain_offset(masked, found, one, offset, level, with_gain=with_gain)
    candidates = {
        "none": (one, np.zeros_like(one)),
        name: (one, offset),
        "registered_offset": (one, registered),
    }
    return candidates | ({"gain_and_offset": (gain, registered)} if with_gain else {})


def choose_correction(nats: dict[str, float]) -> str:
    """The last correction that is likelier than the one kept before by `MIN_NATS`; the fine offset without nats."""
    kept = "none" if nats else "fine_offset"
    for name, each in nats.items():
        if each < nats[kept] - MIN_NATS:
            kept = name
    return kept


def turns_one_way(axis: int) -> Message:
    """The message that the shading across the motion of a camera that turns one way is not separated."""
    motion, where, remedy = ONE_WAY[axis]
    return Message(
        "camera-turns-one-way",
        f"the camera {motion}: the shading of the fixed pattern {where} is not separated from the scenes', and was "
        f"left as it is. {remedy}",
    )


def _low_order_nats(held_out: HeldOutFrames, offset: Array) -> float:
    """Negative log-likelihood of changes of brightness along displacements, free of fine pattern; NaN: unknown."""
    residual = held_out.score(np.ones_like(offset), offset)
    return np.nan if residual is None else residual.nats
