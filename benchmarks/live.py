"""`deepir live`: delay, memory, and quality over time against methods that see a frame at a time: `make bench-live`.

Delay and quality are measured at the camera's rate, with the estimates in a process beside. `DEEPIR_DATA` names the
folder of real data (default ../shared/data); without it only simulated cameras are run.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import matplotlib
import numpy as np
import psutil
from live_stream import Moment, Stream
from recordings_cases import DATA
from recordings_real import calibrated_drive
from recordings_scores import alike
from rivals import OVER_TIME
from written import write

from deepir import Corrector
from deepir.live.estimation import SynchronousEstimator
from deepir.live.sources import Paced, play
from deepir.simulate.recording import RecordingSettings

matplotlib.use("Agg")

SCRIPT = "benchmarks/live.py"
SEED = 61  # no setting was chosen by its recordings
SIMULATED = 300  # frames, that are played forth and back
KINDS = ("drive", "walk", "pan", "drone")
MOVING, STANDING = 60.0, 60.0  # s
TIMES = (1.0, 3.0, 10.0, 60.0)  # s
SETTLED = 75.0  # s, when estimates of the moving camera are done
EVERY = 0.5  # s between two points of the plot


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, help="write the report to this file too")
    parser.add_argument("--plot", type=Path, help="write the plot of quality over time to this file")
    parser.add_argument("--minutes", type=float, default=10.0, help="of the measurement of the delay")
    parser.add_argument("--only", choices=["delay", "quality", "drive"], help="one part of the report")
    options = parser.parse_args()
    parts = {"delay": lambda: delay(60 * options.minutes), "quality": lambda: quality(options.plot), "drive": drive}
    chosen = [options.only] if options.only else list(parts)
    write((line for name in chosen for line in parts[name]()), SCRIPT, options.output)


def delay(seconds: float) -> Iterator[str]:
    """Delay, dropped frames and memory at 60 frames a second."""
    yield "# Live correction\n\n## Delay and memory\n"
    yield f"A simulated walk with people at 60 frames a second for {seconds / 60:g} minutes. The offset drifts, the"
    yield "shutter closes every 30 s, and the camera stands still for 10 s of each minute. Delay of the correction of a"
    yield "frame, ms. Memory of both processes, the simulated scenes among it, after a quarter and at the end.\n"
    yield "| frame | cores | median | 99 of 100 | longest | dropped | estimates | memory, MB |"
    yield "|---|---|---|---|---|---|---|---|"
    for shape, cores in (((512, 640), 2), ((256, 320), 1)):
        settings = RecordingSettings(kind="walk", n_frames=SIMULATED, shape=shape, frame_rate=60.0)
        stream = Stream(settings, SEED, drift=0.002, closures=30.0, moving=50.0, standing=10.0)
        yield _delay_row(stream, seconds, cores)


def _delay_row(stream: Stream, seconds: float, cores: int) -> str:
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, set(sorted(allowed)[:cores]))
    frames = (moment.frame for moment in stream.moments(seconds))
    played, delays, memory = Paced(frames, stream.rate), [], []
    with Corrector() as corrector:
        for shown in play(played, corrector):
            delays.append(1000 * shown.delay)
            if len(delays) % round(seconds * stream.rate / 4) == 0:
                memory.append(_memory())
        status = corrector.status
    os.sched_setaffinity(0, allowed)
    median, most = np.quantile(delays, [0.5, 0.99])
    height, width = stream.gain.shape
    return (
        f"| {width} x {height} | {cores} | {median:.1f} | {most:.1f} | {max(delays):.0f} | {played.dropped} of "
        f"{round(seconds * stream.rate)} | {status.estimates} | {memory[0]:.0f}, {memory[-1]:.0f} |"
    )


def _memory() -> float:
    """Of this process and its children, MB."""
    process = psutil.Process()
    return sum(each.memory_info().rss for each in [process, *process.children(recursive=True)]) / 1e6


@dataclass
class Course:
    """The pattern that is left over time, sigmas."""

    times: list[float] = field(default_factory=list)
    left: list[float] = field(default_factory=list)
    settled: np.ndarray | None = None
    last: np.ndarray | None = None

    def add(self, stream: Stream, moment: Moment, gain: np.ndarray | float, offset: np.ndarray) -> None:
        self.times.append(moment.time)
        self.left.append(stream.left(moment, gain, offset))
        self.last = (offset + (gain - 1) * stream.flat)[stream.good] / stream.noise
        if moment.time <= SETTLED:
            self.settled = self.last

    def at(self, seconds: float) -> float:
        return self.left[int(np.abs(np.array(self.times) - seconds).argmin())]

    @property
    def ghost(self) -> float:
        """What the scene has left in the maps while the camera stood still."""
        assert self.last is not None
        assert self.settled is not None
        return float((self.last - self.settled).std())


def quality(plot: Path | None) -> Iterator[str]:
    """The pattern that is left over time, from nothing."""
    yield "\n## Quality over time\n"
    yield "320 x 240 at 30 frames a second, played at this rate. Fixed pattern that is left, in sigmas of the noise of"
    yield f"a sample, after so many seconds from nothing. The camera moves for {MOVING:.0f} s and then stands still;"
    yield f"ghost: what the scene leaves in the maps in the last {MOVING + STANDING - SETTLED:.0f} s.\n"
    yield f"| camera | method | {' | '.join(f'{each:g} s' for each in TIMES)} | ghost |"
    yield f"|---|---|{'---|' * (len(TIMES) + 1)}"
    courses: dict[str, dict[str, Course]] = {}
    for kind in KINDS:
        settings = RecordingSettings(kind=kind, n_frames=SIMULATED)
        stream = Stream(settings, SEED, moving=MOVING, standing=STANDING)
        moments = list(stream.moments(MOVING + STANDING))
        courses[kind] = {"raw": _raw(stream, moments), "live": _live(stream, moments)}
        frames = np.stack([moment.frame for moment in moments]).astype(np.float32)
        for name, method in OVER_TIME.items():
            course = courses[kind][name] = Course()
            for moment, maps in zip(moments, method(frames), strict=True):
                if _is_plotted(moment, stream):
                    course.add(stream, moment, *maps)
        for name, course in courses[kind].items():
            found = " | ".join(f"{course.at(each):.2f}" for each in TIMES)
            yield f"| {kind} | {name} | {found} | {course.ghost:.2f} |"
    if plot:
        _draw(courses, plot)


def _is_plotted(moment: Moment, stream: Stream) -> bool:
    return round(moment.time * stream.rate) % round(EVERY * stream.rate) == 0


def _raw(stream: Stream, moments: list[Moment]) -> Course:
    course = Course()
    for moment in moments:
        if _is_plotted(moment, stream):
            course.add(stream, moment, 1.0, np.zeros_like(stream.offset))
    return course


def _live(stream: Stream, moments: list[Moment]) -> Course:
    course = Course()
    with Corrector() as corrector:
        for moment in Paced(moments, stream.rate):
            corrector(moment.frame)
            if _is_plotted(moment, stream):
                maps = corrector.maps if corrector.status.correcting else None
                gain, offset = (maps.gain, maps.offset) if maps else (1.0, np.zeros_like(stream.offset))
                course.add(stream, moment, gain, offset)
    return course


def drive() -> Iterator[str]:
    """A real drive as fast as possible: likeness with the calibrated frames."""
    yield "\n## Lynred, a drive of 600 frames\n"
    if (frames := calibrated_drive()) is None:
        yield f"Not run: {DATA} is not there; `DEEPIR_DATA` names the folder of the data."
        return
    raw, calibrated = frames
    with Corrector(estimator=SynchronousEstimator()) as corrector:
        found = [alike(corrector(frame), truth) for frame, truth in zip(raw, calibrated, strict=True)]
    yield "`deepir live --fast`: median likeness with the calibrated frames, a hundred at a time.\n"
    yield f"| {' | '.join(f'{k} to {k + 99}' for k in range(0, len(found), 100))} |\n|{'---|' * (len(found) // 100)}"
    yield f"| {' | '.join(f'{np.median(found[k : k + 100]):.3f}' for k in range(0, len(found), 100))} |"


def _draw(courses: dict[str, dict[str, Course]], path: Path) -> None:
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, len(courses), figsize=(3.2 * len(courses), 3.2), sharey=True, layout="constrained")
    for axis, (kind, methods) in zip(axes, courses.items(), strict=True):
        for name, course in methods.items():
            width = 2.4 if name == "live" else 1.1
            axis.plot(course.times, course.left, label=name.replace("_", " "), linewidth=width)
        axis.axvspan(MOVING, MOVING + STANDING, color="0.9", zorder=0)
        axis.set(title=kind, xlabel="time, s", yscale="log")
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("pattern that is left, sigmas")
    figure.legend(*axes[0].get_legend_handles_labels(), fontsize=8, loc="outside lower center", ncols=6)
    figure.savefig(path, dpi=100)


if __name__ == "__main__":
    main()
