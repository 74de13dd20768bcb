"""Where the frames of the command `live` come from, and where they go."""

from __future__ import annotations

import functools
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from deepir.arrays import Array
from deepir.cameras.camera import Camera
from deepir.cameras.camera import camera_frames as frames_of
from deepir.cli.arguments import recording_radiometry
from deepir.cli.terminal import Interrupted, Interruptible, notify
from deepir.config import Config
from deepir.config.components import make, options_schema
from deepir.config.overrides import parse_settings
from deepir.config.schema import Output
from deepir.errors import ConfigError, DataError
from deepir.io import cropped, stream_data
from deepir.io.output import Write, cast, open_writer, output_type
from deepir.io.radiometry import unit_metadata
from deepir.live import sources
from deepir.live.corrector import Corrector
from deepir.live.recorder import KeptMaps, Recorder
from deepir.live.sources import CorrectedFrame, Paced, stream_raw
from deepir.registry import lookup

if TYPE_CHECKING:
    from deepir.live.page.views import Session

Sink = Callable[[CorrectedFrame], None]

STANDARD = "-"  # in place of a file: standard input or output
STATUS_EVERY = 1.0  # s between two lines of status


@contextmanager
def open_camera(name: str, settings: Sequence[str]) -> Iterator[Camera]:
    """A context with an open camera; prints what is to be known of its built-in correction.

    Args:
        name: Of the driver.
        settings: `KEY=VALUE` of the driver.

    Raises:
        ConfigError: There is no such driver, or a setting is wrong.
        DataError: The camera cannot be opened.
    """
    options: dict[str, Any] = dict(parse_settings(settings, options_schema(lookup("camera", name, "camera"))))
    with make("camera", name, options, "camera") as camera:
        if camera.correction:
            notify(camera.correction)
        yield camera


def camera_frames(camera: Camera, kept: KeptMaps | None, corrector: Corrector) -> Iterable[Array]:
    """The frames (h, w) of a camera; with the first one the corrector begins with the maps that are kept, if any."""
    for number, frame in enumerate(frames_of(camera)):
        if number == 0 and kept and (maps := kept.read(frame.shape)) is not None:
            corrector.begin(maps)
            notify(f"begins with the camera's maps of {kept.date}, {kept.path}; --maps FILE takes others")
        yield frame


def recording_frames(config: Config, rate: float | None) -> Iterable[Array]:
    """The frames of standard input or of a recording; at a rate unless it is None."""
    data = config.data
    if data.path != STANDARD:
        frames = stream_data(data)
    elif data.raw is None:
        raise ConfigError(
            "frames on standard input have no header: give their size, for example "
            "data.raw.width=640 data.raw.height=512"
        )
    else:
        frames = cropped(stream_raw(sys.stdin.buffer, data.raw), data.crop)
    return Paced(frames, rate) if rate else frames


def correct_all(
    frames: Iterable[Array], corrector: Corrector, sinks: Sequence[Sink], *, endless: bool
) -> tuple[str, int]:
    """Correct frames and pass them on, until they end or Ctrl-C.

    Args:
        frames: (h, w) each.
        corrector: Of their camera.
        sinks: They take each corrected frame.
        endless: Ctrl-C is their usual end.

    Returns:
        Why they ended (empty: Ctrl-C), and the exit status.

    Raises:
        DataError: There is no first frame.
    """
    count, ended, status = 0, "the recording has ended", 0
    try:
        for frame in sources.play(frames, corrector):
            for take in sinks:
                take(frame)
            count = frame.number
    except Interrupted as error:
        ended, status = "", 0 if endless else error.status
    except DataError as error:
        if not count:
            raise
        notify(f"error: {error}; what was recorded until then is kept")
        ended, status = str(error), 2
    notify(f"{count} frame(s); {corrector.status}")
    return ended, status


def status_lines() -> Sink:
    """Prints the status every second."""
    printed = time.monotonic()

    def take(frame: CorrectedFrame) -> None:
        nonlocal printed
        if (now := time.monotonic()) - printed > STATUS_EVERY:
            printed = now
            dropped = f", {frame.dropped} dropped" if frame.dropped else ""
            notify(f"{frame.status}; {frame.rate:.0f} frames/s, {1000 * frame.delay:.1f} ms{dropped}")

    return take


def writer(output: str, display: Output, stack: ExitStack) -> Sink:
    """Writes corrected frames, in the type of the first recorded one, to a file or standard output.

    Args:
        output: Name of the file, or `STANDARD`.
        display: Palette and tones of a film.
        stack: Closes the file.
    """
    write: Write | None = None

    def take(frame: CorrectedFrame) -> None:
        nonlocal write
        if write is None:
            dtype = output_type(frame.raw.dtype, rounded=True)
            if output == STANDARD:
                write = functools.partial(_send, sys.stdout.buffer, dtype)
            else:
                write = stack.enter_context(open_writer(Path(output), dtype, {}, display.palette, display.tones))
        write(frame.corrected)

    return take


def _send(stream: IO[bytes], dtype: np.dtype[Any], corrected: Array) -> None:
    try:
        stream.write(cast(corrected, dtype).tobytes())
        stream.flush()
    except OSError as error:
        raise DataError(f"standard output cannot be written: {error.strerror or error}") from None


def keep(corrector: Corrector, kept: KeptMaps) -> None:
    """Keep the maps for the next time, if something was learned and it fits."""
    if corrector.maps is not None and corrector.status.estimates and corrector.status.correcting:
        try:
            kept.save(corrector.maps)
            notify(f"the maps are kept for the next time: {kept.path}")
        except DataError as error:
            notify(f"warning: {error}")


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
    from deepir.live.page.server import serve
    from deepir.live.page.views import Session

    radiometry = recording_radiometry(config) if config else None
    display = config.output if config else Output()
    recorder = Recorder(folder, unit_metadata(radiometry))
    title, tones = Path(source).name, display.tones
    session = Session(corrector, recorder, title=title, radiometry=radiometry, palette=display.palette, tones=tones)
    with serve(session, *address) as url:
        notify(f"the frames are shown at {url}")
        try:
            yield session
        finally:
            recorder.close()
            if recorder.message:
                notify(recorder.message)


def keep_page(session: Session, ended: str) -> None:
    """Show the last frame, and why it is the last, until Ctrl-C."""
    session.end(ended)
    notify("the page stays until Ctrl-C")
    with Interruptible(), suppress(Interrupted):
        while True:
            time.sleep(1)
