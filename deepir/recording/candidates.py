"""The corrections that a recording may get, and the choice between them by frames that were held out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from deepir.messages import Message
from deepir.multiview.texture_flow import Displacement
from deepir.recording.held_out import HeldOutFrames
from deepir.recording.responses import refine_responses

Array = np.ndarray[Any, Any]

LEAST_NATS = 30.0  # by which a larger correction makes held-out frames likelier, to be chosen
#: How a camera turns whose scenes do not move along an axis, where its shading is not separated, and what to do.
ONE_WAY = (
    ("turns sideways only", "from top to bottom", "Tilt the camera too"),
    ("tilts only", "from left to right", "Turn the camera sideways too"),
)


def choose_offset(
    offsets: dict[str, Array], held_out: HeldOutFrames, correction: str
) -> tuple[tuple[str, Array], list[str]]:
    """The offset with or without what is slow, new or former, named as in `CORRECTIONS`; and messages."""
    if correction == "fine_offset":
        return (correction, offsets["fine"]), []
    whole = offsets.get("whole")
    if correction == "offset" and whole is not None:
        return (correction, whole), []
    left = {name: _slow_nats(held_out, each) for name, each in offsets.items()}
    better = [
        name for name in offsets if left["fine"] - left[name] > (LEAST_NATS if name == "whole" else 0.0)
    ]
    if better:
        return ("offset", offsets[min(better, key=left.__getitem__)]), []
    return ("fine_offset", offsets["fine"]), [
        Message(
            "slow-part-not-separated",
            "what is slow of the fixed pattern is not separated from the scenes', and was left as it is: it is weak, "
            "or the camera moves too little",
        )
    ]


def candidate_corrections(
    masked: Array, base: tuple[str, Array], found: Sequence[Displacement], level: float, *, with_gain: bool
) -> dict[str, tuple[Array, Array]]:
    """Corrections (gain, offset), each of more than the one before."""
    name, offset = base
    one = np.ones_like(offset)
    gain, registered = refine_responses(masked, found, one, offset, level, with_gain=with_gain)
    candidates = {
        "none": (one, np.zeros_like(one)),
        name: (one, offset),
        "registered_offset": (one, registered),
    }
    return candidates | ({"gain_and_offset": (gain, registered)} if with_gain else {})


def choose_correction(nats: dict[str, float]) -> str:
    """The simplest correction that no larger one beats clearly; the fine offset where frames do not tell."""
    kept = "none" if nats else "fine_offset"
    for name, each in nats.items():
        if each < nats[kept] - LEAST_NATS:
            kept = name
    return kept


def turns_one_way(axis: int) -> Message:
    """That the shading along an axis is not separated, along which the scenes do not move."""
    motion, where, remedy = ONE_WAY[axis]
    return Message(
        "camera-turns-one-way",
        f"the camera {motion}: the shading of the fixed pattern {where} is not separated from the scenes', and was "
        f"left as it is. {remedy}",
    )


def _slow_nats(held_out: HeldOutFrames, offset: Array) -> float:
    """Of the changes of brightness along displacements, which the fine pattern has no part in; NaN: not judged."""
    left = held_out.left(np.ones_like(offset), offset)
    return np.nan if left is None else left.nats
