"""Estimates of the sensor in a process of its own, so that frames go on meanwhile.

The parent sends keyframes through a pipe, and gets a pickled `Segment` back. A process that ends by itself is started
again with the next keyframes.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import subprocess
import sys
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from typing import IO, Any

import numpy as np

from deepir.arrays.samples import as_float32
from deepir.calibration import CorrectionMaps
from deepir.errors import DataError
from deepir.kernels import memory, threads
from deepir.recording.estimate import estimate_fine_offset
from deepir.recording.keyframes import Keyframes, spread
from deepir.recording.segments import Segment, estimate_segments

SWITCH_INTERVAL = 0.5e-3  # s that a thread keeps the interpreter while keyframes are sent: frames wait no longer
QUICK_KEYFRAMES = 24  # that a quick estimate uses at most: with more the fine offset has the same errors
READY = b"r"  # what the process writes first
ENDED = "the estimating process ended by itself; it is started again"


def newest_segment(keyframes: Keyframes, *, quick: bool, former: CorrectionMaps | None = None) -> Segment:
    """The estimate of the sensor at the end of the keyframes; a `Segment` without one if it is not possible.

    Args:
        keyframes: Of the newest frames.
        quick: Whether the fine offset alone is estimated.
        former: That frames are corrected with now.
    """
    first, last = int(keyframes.numbers[0]), int(keyframes.numbers[-1])
    try:
        with threads.for_samples(keyframes.frames.size), memory.kept():
            if quick:
                some = spread(range(len(keyframes.frames)), QUICK_KEYFRAMES)
                return Segment(first, last, estimate_fine_offset(keyframes.subset(np.array(some))))
            return estimate_segments(keyframes, former=former)[-1]
    except DataError as error:
        return Segment(first, last, None, str(error))


class SynchronousEstimator:
    """What estimates the sensor for a `Corrector`, in the calling process; frames wait."""

    def __init__(self) -> None:
        self._found: Segment | None = None

    def busy(self) -> bool:
        """Whether an estimate is under way: never."""
        return False

    def submit(self, chosen: Keyframes, *, quick: bool, former: CorrectionMaps | None) -> None:
        """Estimate, only when not busy; arguments as in `newest_segment`."""
        self._found = newest_segment(chosen.copied(), quick=quick, former=former)

    def poll(self) -> Segment | None:
        """The newest estimate, once; None if there is none."""
        found, self._found = self._found, None
        return found

    def cancel(self) -> None:
        """Give up the estimate that was not polled."""
        self._found = None

    def close(self) -> None:
        """Nothing is under way."""


class ProcessEstimator:
    """What estimates the sensor for a `Corrector`, in a process of its own."""

    def __init__(self) -> None:
        self._process = self._start()
        self._closed = False
        self._interval = sys.getswitchinterval()
        sys.setswitchinterval(SWITCH_INTERVAL)
        self._sender = ThreadPoolExecutor(1)
        #: Done once the process takes requests: frames that are sent before are old by then.
        self._ready: Future[bool] = self._sender.submit(self._wait)
        self._pending: Future[Segment] | None = None

    def busy(self) -> bool:
        """Whether an estimate is under way, or the process begins."""
        return not self._ready.done() or (self._pending is not None and not self._pending.done())

    def submit(self, chosen: Keyframes, *, quick: bool, former: CorrectionMaps | None) -> None:
        """Begin an estimate, only when not busy; arguments as in `newest_segment`."""
        self._pending = self._sender.submit(self._estimate, chosen, quick, former)

    def poll(self) -> Segment | None:
        """The newest estimate, once it is there; None if there is none."""
        if self._pending is None or self.busy():
            return None
        found, self._pending = self._pending.result(), None
        return found

    def cancel(self) -> None:
        """Give the estimate up: its process ends, and another one takes its place."""
        if self._pending is not None and self.busy():
            self._process.kill()
            self._ready = self._sender.submit(bool, 1)  # after the process that takes its place has begun
        self._pending = None

    def close(self) -> None:
        """End the process."""
        self._closed = True
        sys.setswitchinterval(self._interval)
        self._process.kill()
        self._sender.shutdown(cancel_futures=True)
        self._end()

    def _restart(self) -> None:
        if not self._closed:
            self._end()
            self._process = self._start()
            self._wait()

    def _wait(self) -> bool:
        """Wait until the process takes requests; false if it has ended."""
        assert self._process.stdout is not None
        try:
            return self._process.stdout.read(len(READY)) == READY
        except (OSError, ValueError):  # closed meanwhile
            return False

    def _end(self) -> None:
        self._process.kill()
        for pipe in (self._process.stdin, self._process.stdout):
            with contextlib.suppress(OSError):  # what it has not read is lost
                assert pipe is not None
                pipe.close()
        self._process.wait()

    def _start(self) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, "-m", "deepir.live.estimation"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )

    def _estimate(self, chosen: Keyframes, quick: bool, former: CorrectionMaps | None) -> Segment:
        """Send keyframes, frame by frame, and wait for the estimate."""
        if self._process.poll() is not None:
            self._restart()
        to, back = self._process.stdin, self._process.stdout
        assert to is not None
        assert back is not None
        try:
            shape, empty = (len(chosen.frames), *chosen.frames[0].shape), replace(chosen, frames=np.empty(0))
            pickle.dump((shape, empty, quick, former), to)
            for frame in chosen.frames:
                to.write(as_float32(frame).data)
            to.flush()
            found: Segment = pickle.load(back)
        except (OSError, EOFError, ValueError, pickle.UnpicklingError):  # ValueError: closed meanwhile
            self._restart()
            return Segment(int(chosen.numbers[0]), int(chosen.numbers[-1]), None, ENDED)
        return found


def serve(requests: IO[bytes], answers: IO[bytes]) -> None:
    """Answer requests until there are no more."""
    while True:
        try:
            shape, empty, quick, former = pickle.load(requests)
        except EOFError:
            return
        frames = np.empty(shape, np.float32)
        for frame in frames:
            frame[:] = np.frombuffer(requests.read(frame.nbytes), np.float32).reshape(frame.shape)
        found = newest_segment(replace(empty, frames=frames), quick=quick, former=former)
        found.correct(frames[-1])  # what it computes once goes with it: no frame waits for it
        pickle.dump(found, answers)
        answers.flush()


def main() -> None:
    """The process: requests come by standard input, answers leave by what was standard output."""
    if hasattr(os, "nice"):
        os.nice(10)  # where systems have it: frames come first
    answers: Any = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # whatever prints does not disturb
    answers.write(READY)
    answers.flush()
    serve(sys.stdin.buffer, answers)


if __name__ == "__main__":
    main()
