"""`deepir live`."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated, Any

import typer

from deepir.cli.arguments import DATA_SETTINGS, Overwrite, Plugins, Settings, load_plugins, recording_config

if TYPE_CHECKING:
    from deepir.io.output.recording import Array, Write
    from deepir.live.corrector import Corrector

ACCEPTED_SETTINGS = (*DATA_SETTINGS, "output.palette", "output.tones")  # keys, of a recording
STATUS_EVERY = 1.0  # s between two lines of status
STANDARD = "-"  # in place of a file: standard input or output


def live(
    source: Annotated[
        str | None,
        typer.Argument(
            metavar="[FILE]", help="A recording; - for raw frames on standard input (data.raw=...)."
        ),
    ] = None,
    settings: Settings = None,
    camera: Annotated[
        str | None, typer.Option(help="A camera instead: v4l2, boson.", show_default=False)
    ] = None,
    output: Annotated[
        str | None,
        typer.Option(
            help="A .tif, or an .mp4 to look at; - for raw frames on standard output. Nothing unless given.",
            show_default=False,
        ),
    ] = None,
    rate: Annotated[
        float, typer.Option(min=0.1, help="Frames a second at which a recording is played.")
    ] = 30.0,
    fast: Annotated[
        bool, typer.Option("--fast", help="As fast as possible: frames wait for each estimate.")
    ] = False,
    maps: Annotated[
        Path | None, typer.Option(help="Maps of this camera to begin with.", show_default=False)
    ] = None,
    save_maps: Annotated[
        Path | None, typer.Option(help="Write the newest maps here at the end.", show_default=False)
    ] = None,
    overwrite: Overwrite = False,
    plugin: Plugins = None,
) -> int:
    """Correct frames as they come, better and better while the camera moves: deepir live drive.avi --output live.mp4.

    Settings of a recording: data.key, data.raw, data.axes, data.swap_bytes, data.radiometry, output.palette,
    output.tones; of a camera: its driver's, such as device=/dev/video2.
    """
    load_plugins(plugin)
    from deepir.calibration import read_maps
    from deepir.cli.signals import Interrupted, Interruptible
    from deepir.errors import ConfigError, DataError
    from deepir.live.corrector import Corrector
    from deepir.live.estimation import Beside, Here

    if (source is None) == (camera is None):
        raise ConfigError(
            "give a recording, or a camera: deepir live drive.avi, or deepir live --camera v4l2"
        )
    for each in (output, save_maps):
        if each and each != STANDARD and Path(each).exists() and not overwrite:
            raise DataError(f"{each} exists; replace it with --overwrite, or give another name")
    start = read_maps(maps) if maps else None
    status = 0
    with Corrector(start, estimator=Here() if fast else Beside()) as corrector:
        with Interruptible(), ExitStack() as stack:
            try:
                frames = _frames(source, camera, settings or (), stack)
                _play(frames, corrector, output, settings or (), None if fast or camera else rate, stack)
            except Interrupted as error:  # the usual end of a camera: what was recorded is kept
                status = 0 if camera else error.status
            except DataError as error:
                if not corrector.status.frames:
                    raise
                _notify(f"error: {error}; what was recorded until then is kept")
                status = 2
        _notify(f"{corrector.status.frames} frame(s); {_state(corrector)}")
        if save_maps and corrector.maps is not None:
            corrector.maps.save(save_maps)
    return status


def _frames(
    source: str | None, camera: str | None, settings: Sequence[str], stack: ExitStack
) -> Iterator[Array]:
    """The frames of a camera, of standard input or of a recording."""
    from deepir.errors import ConfigError
    from deepir.io import stream_data
    from deepir.live.sources import camera_frames, stream_raw

    if camera is not None:
        from deepir.config.components import make, options_schema
        from deepir.config.overrides import parse_settings
        from deepir.registry import lookup

        options: dict[str, Any] = dict(
            parse_settings(settings, options_schema(lookup("camera", camera, "camera")))
        )
        opened = stack.enter_context(make("camera", camera, options, "camera"))
        if opened.correction:
            _notify(opened.correction)
        return camera_frames(opened)
    config = recording_config(str(source), settings, ACCEPTED_SETTINGS)
    if source != STANDARD:
        return stream_data(config.data)
    if config.data.raw is None:
        raise ConfigError(
            "frames on standard input have no header: give their size, for example "
            "data.raw.width=640 data.raw.height=512"
        )
    return stream_raw(sys.stdin.buffer, config.data.raw)


def _play(
    frames: Iterable[Array],
    corrector: Corrector,
    output: str | None,
    settings: Sequence[str],
    rate: float | None,
    stack: ExitStack,
) -> None:
    """Correct and write all frames, and say every second how it goes."""
    from deepir.live.sources import Paced

    played = Paced(frames, rate) if rate else frames
    write: Write | None = None
    said, counted = time.monotonic(), 0
    for frame in played:
        if write is None:
            write = _writer(output, frame, settings, stack)
        begun = time.perf_counter()
        corrected = corrector(frame)
        delay = time.perf_counter() - begun
        write(corrected)
        counted += 1
        if (now := time.monotonic()) - said > STATUS_EVERY:
            dropped = f", {played.dropped} dropped" if isinstance(played, Paced) else ""
            _notify(
                f"{_state(corrector)}; {counted / (now - said):.0f} frames/s, {1000 * delay:.1f} ms{dropped}"
            )
            said, counted = now, 0


def _writer(output: str | None, frame: Array, settings: Sequence[str], stack: ExitStack) -> Write:
    """What takes corrected frames, in the type of the first recorded one."""
    from deepir.io.output.recording import cast, open_writer, output_type

    dtype = output_type(frame.dtype, rounded=True)
    if output is None:
        return lambda corrected: None
    if output == STANDARD:
        stream = standard_output()
        return lambda corrected: _send(stream, cast(corrected, dtype))
    shown = recording_config(
        output, [each for each in settings if each.startswith("output.")], ACCEPTED_SETTINGS
    )
    write: Write = stack.enter_context(
        open_writer(Path(output), dtype, {}, shown.output.palette, shown.output.tones)
    )
    return write


def standard_output() -> IO[bytes]:
    """Standard output, for bytes."""
    return sys.stdout.buffer


def _send(stream: IO[bytes], frame: Array) -> None:
    stream.write(frame.tobytes())
    stream.flush()


def _state(corrector: Corrector) -> str:
    """What it does, in a few words."""
    now = corrector.status
    if now.correcting:
        state = f"correcting, {now.estimates} estimate(s)"
    elif now.keyframes == 0:
        state = "waiting for motion"
    else:
        state = "uncorrected: the maps do not fit" if corrector.maps else "learning"
    return f"{state}, {now.keyframes} keyframes" + (f" ({now.message})" if now.message else "")


def _notify(line: str) -> None:
    typer.echo(f"deepir: {line}", err=True)
