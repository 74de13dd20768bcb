"""What the correcting thread and the viewers share: the newest frame one way, commands the other way."""

from __future__ import annotations

import queue
from typing import Literal

from deepir.io.output.tone_mapping import PERCENTILE, WHITE_HOT
from deepir.io.radiometry import Radiometry
from deepir.live.corrector import Corrector
from deepir.live.playback import CorrectedFrame
from deepir.live.recorder import Recorder

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
            self._execute(self._commands.get())

    def end(self, reason: str) -> None:
        """No more frames come."""
        self.recorder.stop()
        self.ended = reason

    def submit(self, command: Command) -> None:
        """A command of a viewer; executed with the next frame."""
        self._commands.put(command)

    def _execute(self, command: Command) -> None:
        match command:
            case "hold":
                self._corrector.hold = True
            case "learn":
                self._corrector.hold = False
            case "reset":
                self._corrector.reset()
            case "record":
                self.recorder.start()
            case "stop":
                self.recorder.stop()
