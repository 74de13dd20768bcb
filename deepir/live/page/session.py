"""What the loop of the pictures and the viewers share: the newest frame one way, orders the other way."""

from __future__ import annotations

import queue
from typing import Literal

from deepir.io.output.tone_mapping import PERCENTILE, WHITE_HOT
from deepir.io.radiometry import Radiometry
from deepir.live.corrector import Corrector
from deepir.live.playback import Moment
from deepir.live.recorder import Recorder

Order = Literal["hold", "learn", "reset", "record", "stop"]  # of a viewer


class Session:
    """The newest frame for viewers in other threads, and what they order.

    Only the newest frame is kept, and nothing is computed until a viewer asks for it. Orders are carried out between
    two frames, in the thread of the pictures.

    Args:
        corrector: That the pictures come from.
        recorder: For recordings that viewers order.
        title: What the pictures are of.
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
        self.newest: Moment | None = None
        self.ended = ""
        self._corrector = corrector
        self._orders: queue.SimpleQueue[Order] = queue.SimpleQueue()

    def show(self, moment: Moment) -> None:
        """The next frame; carries out what was ordered."""
        self.recorder.add(moment.raw, moment.corrected)
        self.newest = moment
        while not self._orders.empty():
            self._obey(self._orders.get())

    def end(self, reason: str) -> None:
        """No more frames come."""
        self.recorder.stop()
        self.ended = reason

    def order(self, order: Order) -> None:
        """Of a viewer; carried out with the next frame."""
        self._orders.put(order)

    def _obey(self, order: Order) -> None:
        match order:
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
