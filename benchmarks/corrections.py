"""`deepir correct` on whole recordings, against methods that take recordings too: `make bench-correct`.

Simulated recordings have a truth: the fixed pattern that is left, in sigmas of the noise of a sample. The real drive
has frames that a black body has calibrated: the median likeness of frames that are no keyframes. `DEEPIR_DATA` names
the folder of real data (default ../shared/data); without it only the simulated ones are run.
"""

from __future__ import annotations

import argparse
import functools
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from recordings import BONNET, DATA, alike, calibrated_drive, detail_correlation, left
from rivals import OVER_TIME, Maps
from written import write

import deepir
from deepir.baselines.online import last_of
from deepir.baselines.temporal.multiview_tv import median_offset
from deepir.errors import DeepIRError
from deepir.multiview.held_out_pattern import CorrectionScorer
from deepir.simulate.recording import Recording, RecordingSettings, simulate_recording
from deepir.simulate.recording.settings import RECORDING_KINDS

SCRIPT = "benchmarks/corrections.py"
CAMERA = RecordingSettings(n_frames=240)  # at 30 frames a second
CAMERAS: dict[str, dict[str, Any]] = {
    "raw": {},
    "raw, shaded": {"shading": 0.6, "gain_pixel": 0.01},
    "after a shutter": {"shutter_every": 60.0, "drift": 0.01, "tau_ms": 10.0},
    "8 bits, lossy": {"agc": True, "compression": "h264"},
}
SEED = 22  # no setting was chosen by its recordings
HELD_OUT, MARGIN = 8, 2  # frames of the A65 that are held out, and beside them, which no estimate uses either
HELD_OUT_AT = (14, 32, 50)
#: Problems for bursts, and frames before those that are held out, which they use.
BURSTS = [("nuc", 5), ("nuc", 10), ("flow", 5), ("flow", 10)]
JUDGED = 4  # frames, of which one is judged


def _after_all(method: Callable[[np.ndarray], Iterator[Maps]], frames: np.ndarray) -> Maps:
    return last_of(method(frames))


RIVALS: dict[str, Callable[[np.ndarray], Maps]] = {
    **{name: functools.partial(_after_all, method) for name, method in OVER_TIME.items()},
    "multiview_tv": lambda frames: (1.0, median_offset(frames)),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, help="write the report to this file too")
    parser.add_argument("--only", choices=["simulated", "drive", "a65"], help="one part of the report")
    options = parser.parse_args()
    parts = {"drive": drive, "a65": a65, "simulated": simulated}
    chosen = [parts[options.only]] if options.only else list(parts.values())
    write((line for part in chosen for line in part()), SCRIPT, options.output)


def drive() -> Iterator[str]:
    """Likeness with the calibrated frames of a drive."""
    yield "# Whole recordings\n\n## Lynred, a drive of 600 frames\n"
    if (frames := calibrated_drive()) is None:
        yield f"Not run: {DATA} is not there; `DEEPIR_DATA` names the folder of the data."
        return
    raw, calibrated = frames
    begun = time.perf_counter()
    corrected = deepir.correct(raw)
    seconds = time.perf_counter() - begun
    others = np.setdiff1d(np.arange(len(raw)), corrected.keyframes.numbers)

    def likeness(correct: Callable[[np.ndarray, int], np.ndarray]) -> list[float]:
        return [alike(correct(raw[k], int(k)), calibrated[k]) for k in others]

    yield "Likeness with the calibrated frames: the median (least) of frames that are no keyframes.\n"
    yield "| method | likeness | worse than raw | seconds |\n|---|---|---|---|"
    before = likeness(lambda frame, number: frame)
    yield f"| raw | {np.median(before):.3f} ({min(before):.2f}) | | |"
    for name, rival in RIVALS.items():
        begun = time.perf_counter()
        gain, offset = rival(raw)
        took = time.perf_counter() - begun
        yield _row(name, likeness(lambda frame, number, g=gain, o=offset: (frame - o) / g), before, took)
    yield _row(f"correct ({corrected.estimate.kept})", likeness(corrected.correct), before, seconds)


def _row(name: str, found: list[float], before: list[float], seconds: float) -> str:
    worse = sum(a < b for a, b in zip(found, before, strict=True))
    return f"| {name} | {np.median(found):.4f} ({min(found):.2f}) | {worse} of {len(found)} | {seconds:.1f} |"


def a65() -> Iterator[str]:
    """How well held-out frames of a drive with the factory's correction are predicted."""
    yield "\n## FLIR A65, a drive of 70 frames, corrected by its factory\n"
    if not (DATA / "a65").is_dir():
        yield f"Not run: {DATA} is not there."
        return
    parts = [DATA / "a65" / f"a65_frames_{part}.npz" for part in ("000-009", "010-069")]
    frames = np.concatenate([deepir.read_frames(part).frames for part in parts])[:, :BONNET]
    whole = deepir.correct(frames).frames
    pairs = [(40, 69), (44, 65), (0, 29)]
    far = [np.mean([detail_correlation(each[i], each[j]) for i, j in pairs]) for each in (frames, whole)]
    yield f"Correlation of the fine detail of frames 21 to 29 apart: {far[0]:.3f} raw, {far[1]:.3f} corrected.\n"
    yield f"What is left along the displacements of {HELD_OUT} frames that no estimate used, counts: of the fine"
    yield "pattern, and of what is slow. Least nats are best; 0 is raw.\n"
    yield "| held out | method | fine | slow | nats |\n|---|---|---|---|---|"
    for start in HELD_OUT_AT:
        yield from _held_out_rows(frames, start)


def _held_out_rows(frames: np.ndarray, start: int) -> Iterator[str]:
    last = start + HELD_OUT - 1
    others = np.setdiff1d(np.arange(len(frames)), np.arange(start - MARGIN, last + MARGIN + 1))
    held = frames[start : last + 1].astype(np.float32)
    half = HELD_OUT // 2
    corrected = deepir.correct(frames[others]).maps
    maps = {"correct": (corrected.gain, corrected.offset)}
    for problem, count in BURSTS:
        used = [int(k) for k in others[others < start][-count:]]
        result = deepir.run(problem, frames=frames, data={"frames": used})
        maps[f"{problem}, {count} frames"] = result.gain, result.offset
    one = np.ones(held.shape[1:])
    for name, (gain, offset) in maps.items():
        scorer = CorrectionScorer(
            held,
            np.ones(held.shape, bool),
            [(k, k + half) for k in range(half)],
            [(one, 0 * one), (gain, offset)],
        )
        before, after = scorer.score(one, 0 * one), scorer.score(gain, offset)
        if before is None or after is None:
            yield f"| {start} to {last} | {name} | not judged | | |"
            continue
        nats = after.nats - before.nats + float(np.nan_to_num(after.detail_nats - before.detail_nats))
        cells = f"{before.detail:.2f} to {after.detail:.2f} | {before.change:.2f} to {after.change:.2f} | {nats:.0f}"
        yield f"| {start} to {last} | {name} | {cells} |"


def simulated() -> Iterator[str]:
    """The pattern that is left of recordings with truth."""
    yield "\n## Simulated recordings\n"
    yield f"{CAMERA.n_frames} frames of {CAMERA.shape[1]} x {CAMERA.shape[0]}. Fixed pattern that is left, in sigmas"
    yield "of the noise of a sample; in brackets its fine part. Seconds are of `correct`, estimate alone.\n"
    yield f"| recording | camera | raw | {' | '.join(RIVALS)} | correct | what | seconds |"
    yield "|---|---|---|" + "---|" * (len(RIVALS) + 3)
    for kind in RECORDING_KINDS:
        for name, camera in CAMERAS.items():
            yield _simulated_row(
                kind, name, simulate_recording(replace(CAMERA, kind=kind, **camera), seed=SEED)
            )


def _simulated_row(kind: str, camera: str, recording: Recording) -> str:
    frames = recording.frames.astype(np.float32)
    judged = every(recording, JUDGED)
    cells = [left(frames[::JUDGED], judged)]
    for rival in RIVALS.values():
        gain, offset = rival(frames)
        cells.append(left((frames[::JUDGED] - offset) / gain, judged))
    begun = time.perf_counter()
    try:
        corrected = deepir.correct(recording.frames)
    except DeepIRError as error:
        return f"| {kind} | {camera} | {' | '.join(cells)} | refused: {str(error)[:40]} | | |"
    seconds = time.perf_counter() - begun
    numbers = range(0, len(recording.frames), JUDGED)
    after = np.stack([corrected.correct(recording.frames[k], k) for k in numbers])
    cells.append(f"**{left(after, judged)}**")
    parts = f", {len(corrected.segments)} segments" if len(corrected.segments) > 1 else ""
    what = corrected.estimate.kept.replace("_", " ") + parts
    return f"| {kind} | {camera} | {' | '.join(cells)} | {what} | {seconds:.1f} |"


def every(recording: Recording, stride: int) -> Recording:
    """Some frames of a recording with their truth."""
    truth = recording.truth
    parts = ("scene", "offset", "shutter", "agc_gain", "agc_offset")
    some = replace(truth, **{part: getattr(truth, part)[::stride] for part in parts})
    return replace(recording, frames=recording.frames[::stride], truth=some)


if __name__ == "__main__":
    main()
