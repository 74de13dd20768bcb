"""Drives of a real film and hand-held windows of real pictures under drawn patterns: recordings with exact truth.

They are made by recordings.py in the folder bench beside the data (`DEEPIR_DATA`), another draw for each seed.
"""

from __future__ import annotations

import functools
import importlib.util
import re
import types

import numpy as np
from recordings_cases import APART, DATA, DRAWN, Case, absent
from recordings_limit import low_order_limit
from recordings_methods import BURST, Correction
from recordings_scores import Figures, bad_pixels, covered, mean_error

FAMILIES = ("hand-held", "agc", "drive")
CODE = ("recordings_drawn.py", "recordings_limit.py")
EIGHT_BITS = (0, 255)  # least and largest count under gain control


def missing(family: str) -> str:
    return absent(DATA, DRAWN)


def names(family: str, seed: int) -> list[str]:
    return [name for name in drawn().cases(str(DATA), seed) if family_of(name) == family]


def family_of(name: str) -> str:
    first = name.split(maxsplit=1)[0]
    return first if first in FAMILIES else "hand-held"


def load(family: str, name: str, seed: int) -> Case:
    make = drawn().cases(str(DATA), seed)[name]
    frames, truth = make()
    #: The patterns of hand-held windows have none; the film of the drive has some of its own.
    no_bad = None if family == "drive" else np.zeros(frames.shape[1:], bool)
    limit: Figures = {}
    if family == "hand-held":
        limit["limit"] = low_order_limit(drawn(), make.args)
    elif family == "agc":
        truth = truth | {"scene": np.clip(truth["scene"], *EIGHT_BITS)}  # what a camera without a pattern shows
        without = frames - truth["gain"][:, None, None] * truth["pattern"]
        limit["limit"] = drawn().score(without, frames, truth)["low"]

    def judge(corrected: np.ndarray, correction: Correction) -> Figures:
        error = mean_error(corrected, truth["scene"], truth.get("gain"))
        return (
            drawn().score(corrected, frames, truth)
            | limit
            | covered(correction.error(truth["pattern"], error), correction.deviation)
            | bad_pixels(correction.bad_pixels, no_bad)
        )

    film = re.match(r"drive \d+x(\d+)", name)
    apart = APART // int(film[1]) if film else (len(frames) - 1) // (BURST - 1)
    return Case(frames, np.arange(len(frames)), judge, max(1, apart))


@functools.cache
def drawn() -> types.ModuleType:
    spec = importlib.util.spec_from_file_location("drawn_recordings", DRAWN)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
