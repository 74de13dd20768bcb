"""Real recordings: a drive with its calibrated film, and cameras that their makers have corrected.

Lynred: likeness with frames that a black body has calibrated, whole and in pieces. The others have little pattern or
none: a low-order part that is taken off is wrong. Some frames in their middle are held out, and are asked how much
pattern they keep. `DEEPIR_DATA` names the folder of the data (default ../shared/data).
"""

from __future__ import annotations

import functools
from collections.abc import Iterator

import numpy as np
from nuc_store import kept
from recordings_cases import APART, DATA, Case, absent
from recordings_methods import Correction
from recordings_scores import Figures, alike, bad_pixels, covered, held_out, left_over, mean_error, taken_off

import deepir

Array = np.ndarray

FAMILIES = ("real", "corrected")
CODE = ("recordings_real.py",)
LENGTH = 600  # frames of the drive
PIECES = (50, 100, 200)  # frames
ROUNDS = 12  # of least squares and median that find a true pattern
MOST_JUDGED = 100  # frames
BONNET = 420  # row of the A65's frames below which its car is seen
LEPTONS = {"lepton": "lepton_tlinear_82x120x160.npz", "lepton, CPTV": "v2.cptv"}
HELD_OUT, MARGIN = 8, 2  # frames that are held out, and beside them, which no estimate uses either


def missing(family: str) -> str:
    return absent(DATA)


def names(family: str, seed: int) -> list[str]:
    """The same for each seed: none is drawn."""
    return list(_pieces() if family == "real" else _corrected_already())


def load(family: str, name: str, seed: int) -> Case:
    return _drive(name) if family == "real" else _without_pattern(name)


def _pieces() -> Iterator[str]:
    if (DATA / "lynred_car").is_dir():
        yield f"lynred 0:{LENGTH}"
        for size in PIECES:
            for first in range(0, LENGTH - size + 1, size):
                yield f"lynred {first}:{first + size}"


def _corrected_already() -> Iterator[str]:
    if (DATA / "a65").is_dir():
        yield from (f"a65 without {start}:{start + HELD_OUT}" for start in (14, 32, 50))
    if (DATA / "lynred_car").is_dir():
        yield "lynred, calibrated"
    if (DATA / "lepton").is_dir():
        yield from LEPTONS
    yield from sorted(f"tensoristd {path.stem}" for path in (DATA / "tensoristd").glob("*.npz"))


def calibrated_drive() -> tuple[Array, Array] | None:
    """The Lynred drive, raw and calibrated by a black body, (N, h, w) each; None if it is not there."""
    folder = DATA / "lynred_car"
    if not folder.is_dir():
        return None
    raw, calibrated = (deepir.read_frames(folder / f"{name}.avi").frames for name in ("raw", "calibrated"))
    return raw, calibrated


@functools.cache
def lynred() -> tuple[Array, Array]:
    """The drive in its 8 bits."""
    films = calibrated_drive()
    assert films is not None
    return films[0].astype(np.uint8), films[1].astype(np.uint8)


@functools.cache
def lynred_pattern() -> Array:
    """Its true pattern; kept, as it takes a minute."""
    return kept("recordings", ["lynred's pattern", ROUNDS], lambda: {"pattern": true_pattern(*lynred())})["pattern"]


def true_pattern(raw: Array, calibrated: Array) -> Array:
    """F of `raw = s calibrated + l + F`, by turns of least squares for s and l and the median over the frames."""
    some = np.arange(0, len(raw), 5)
    pattern = np.zeros(raw.shape[1:])
    for _ in range(ROUNDS):
        rest = []
        for y, x in zip(raw[some], calibrated[some], strict=True):
            slope, level = np.polyfit(x.ravel()[::7].astype(float), (y - pattern).ravel()[::7], 1)
            rest.append(y - slope * x - level)
        pattern = np.median(rest, axis=0)
    return np.asarray(pattern - pattern.mean())


def _drive(name: str) -> Case:
    first, last = (int(each) for each in name.split()[1].split(":"))
    frames, reference = (film[first:last] for film in lynred())
    pattern, judged = lynred_pattern(), _some(len(frames))
    scene = frames[judged] - pattern

    def judge(corrected: Array, correction: Correction) -> Figures:
        error = mean_error(corrected, scene)
        like, before = (
            float(np.median([alike(a, b) for a, b in zip(each, reference[judged], strict=True)]))
            for each in (corrected, frames[judged])
        )
        return {
            **left_over(error, pattern),
            "likeness": like,
            "raw likeness": before,
            **covered(error, correction.deviation),
            **bad_pixels(correction.bad_pixels, None),
        }

    return Case(frames, judged, judge, APART)


def _without_pattern(name: str) -> Case:
    film, start = _film(name)
    used = np.r_[: start - MARGIN, start + HELD_OUT + MARGIN : len(film)]
    frames, held = film[used], film[start : start + HELD_OUT].astype(np.float32)
    judged = _some(len(frames))

    def judge(corrected: Array, correction: Correction) -> Figures:
        return {
            **taken_off(frames[judged], corrected),
            **held_out(held, correction.maps),
            **bad_pixels(correction.bad_pixels, None),
        }

    return Case(frames, judged, judge, APART if name.startswith("lynred") else APART // 2)


def _film(name: str) -> tuple[Array, int]:
    """Frames, and the number of the first one that is held out."""
    if name.startswith("a65"):
        parts = [DATA / "a65" / f"a65_frames_{part}.npz" for part in ("000-009", "010-069")]
        frames = np.concatenate([np.load(part)["frames"] for part in parts])[:, :BONNET]
        return frames, int(name.rsplit(maxsplit=1)[-1].partition(":")[0])
    if name.startswith("lynred"):
        frames = lynred()[1]
    elif name in LEPTONS:
        frames = deepir.read_frames(DATA / "lepton" / LEPTONS[name]).frames
    else:
        frames = np.load(DATA / "tensoristd" / f"{name.rsplit(maxsplit=1)[-1]}.npz")["frames"]
    return frames, len(frames) // 2


def _some(length: int) -> Array:
    return np.unique(np.linspace(0, length - 1, min(length, MOST_JUDGED)).astype(int))
