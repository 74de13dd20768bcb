"""The page of `deepir live`."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from deepir.cli.arguments import recording_radiometry
from deepir.cli.signals import Interrupted, Interruptible
from deepir.cli.terminal import notify
from deepir.config import Config
from deepir.io.radiometry import unit_metadata
from deepir.live.corrector import Corrector
from deepir.live.page.server import serve
from deepir.live.page.session import Session
from deepir.live.recorder import Recorder


@contextmanager
def open_page(
    corrector: Corrector, source: str, config: Config | None, address: tuple[str, int], folder: Path
) -> Iterator[Session]:
    """A context with a page; what its session is given is shown there.

    Args:
        corrector: Of the frames.
        source: Of the frames: a file or a camera.
        config: Of the file; None for a camera.
        address: Host and port of the page.
        folder: For recordings.
    """
    radiometry = recording_radiometry(config) if config else None
    recorder = Recorder(folder, unit_metadata(radiometry))
    display = {"palette": config.output.palette, "tones": config.output.tones} if config else {}
    session = Session(corrector, recorder, title=Path(source).name, radiometry=radiometry, **display)
    with serve(session, *address) as url:
        notify(f"the frames are shown at {url}")
        try:
            yield session
        finally:
            recorder.close()
            if recorder.message:
                notify(f"{recorder.message}")


def keep_page(session: Session, ended: str) -> None:
    """Show the last frame, and why it is the last, until Ctrl-C."""
    session.end(ended)
    notify("the page stays until Ctrl-C")
    with Interruptible(), suppress(Interrupted):
        while True:
            time.sleep(1)
