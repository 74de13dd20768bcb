"""`deepir live`."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated

import typer

from deepir.cli.arguments import (
    RECORDING_SETTINGS,
    Overwrite,
    Plugins,
    ReadingSettings,
    held_outputs,
    load_plugins,
    recording_config,
)
from deepir.cli.terminal import notify

if TYPE_CHECKING:
    from deepir.config.schema import Output
    from deepir.io.output.recording import Array, Write
    from deepir.live.corrector import Corrector
    from deepir.live.page.views import Session
    from deepir.live.recorder import KeptMaps
    from deepir.live.sources import CorrectedFrame

STATUS_EVERY = 1.0  # s between two lines of status
OF_THE_PAGE = ("port", "host", "record_to")  # options
STANDARD = "-"  # in place of a file: standard input or output


def live(
    context: typer.Context,
    source: Annotated[
        str | None,
        typer.Argument(
            metavar="[FILE]", help="A recording; - for raw frames on standard input (data.raw=...)."
        ),
    ] = None,
    settings: ReadingSettings = None,
    camera: Annotated[
        str | None,
        typer.Option(help="Driver of a camera in place of a recording: v4l2, boson.", show_default=False),
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
    virtual: Annotated[
        bool, typer.Option("--virtual-camera", help="Show the frames as a camera to video programs.")
    ] = False,
    page: Annotated[
        bool, typer.Option("--page", help="Show the frames in the browser, with controls, until Ctrl-C.")
    ] = False,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port of the page; 0: any free port.")] = 8265,
    host: Annotated[
        str,
        typer.Option(help="Address of this machine for the page; 0.0.0.0: for others in the network too."),
    ] = "127.0.0.1",
    record_to: Annotated[
        Path, typer.Option(metavar="FOLDER", help="Folder of the recordings that are started on the page.")
    ] = Path(),
    overwrite: Overwrite = False,
    plugin: Plugins = None,
) -> int:
    """Correct frames as they come, better and better while the camera moves: deepir live drive.avi --page.

    Settings of a recording: data.key, data.raw, data.axes, data.crop, data.swap_bytes, data.radiometry,
    output.palette, output.tones; of a camera: its driver's, such as device=/dev/video2.
    """
    load_plugins(plugin)
    from deepir.calibration import read_maps
    from deepir.live.corrector import Corrector
    from deepir.live.estimation import ProcessEstimator, SynchronousEstimator

    _check(context, source, camera, page=page)
    options = _Options(
        source=source,
        camera=camera,
        settings=settings or (),
        output=output,
        rate=rate,
        fast=fast,
        virtual=virtual,
        page=(host, port) if page else None,
        record_to=record_to,
        save_maps=save_maps,
    )
    files = [Path(each) for each in (output, save_maps) if each and each != STANDARD]
    start = read_maps(maps) if maps else None
    with (
        held_outputs(*files, overwrite=overwrite, source=source),
        Corrector(start, estimator=SynchronousEstimator() if fast else ProcessEstimator()) as corrector,
    ):
        return _run(options, corrector)


@dataclass(frozen=True)
class _Options:
    """Options of the command, by their names; `page` is host and port of the page, if there is one."""

    source: str | None
    camera: str | None
    settings: Sequence[str]
    output: str | None
    rate: float
    fast: bool
    virtual: bool
    page: tuple[str, int] | None
    record_to: Path
    save_maps: Path | None


def _run(options: _Options, corrector: Corrector) -> int:
    """Correct frames until they end, or Ctrl-C; the exit status."""
    from deepir.cli.terminal import Interrupted, Interruptible
    from deepir.errors import DataError

    status, count, ended = 0, 0, "the recording has ended"
    session: Session | None = None
    kept: KeptMaps | None = None
    with ExitStack() as page:
        with Interruptible(), ExitStack() as stack:
            try:
                frames, kept = _open_source(options, corrector, stack)
                session = _open_page(options, corrector, page)
                for frame in _play(frames, corrector, options, session, stack):
                    count = frame.number
            except Interrupted as error:  # the usual end of a camera: what was recorded is kept
                status, ended = 0 if options.camera else error.status, ""
            except DataError as error:
                if not count:
                    raise
                notify(f"error: {error}; what was recorded until then is kept")
                status, ended = 2, str(error)
        notify(f"{count} frame(s); {corrector.status}")
        _finish(corrector, options.save_maps, kept, session, ended)
    return status


def _check(context: typer.Context, source: str | None, camera: str | None, *, page: bool) -> None:
    """Raise `ConfigError` on options that do not go together."""
    from deepir.errors import ConfigError

    if (source is None) == (camera is None):
        raise ConfigError(
            "give a recording, or a camera: deepir live drive.avi, or deepir live --camera v4l2"
        )
    for option in () if page else OF_THE_PAGE:
        how = context.get_parameter_source(option)
        if how is not None and how.name == "COMMANDLINE":
            raise ConfigError(f"--{option.replace('_', '-')} is an option of the page: add --page")


def _open_source(
    options: _Options, corrector: Corrector, stack: ExitStack
) -> tuple[Iterable[Array], KeptMaps | None]:
    """The frames of the camera or of the recording, and the maps that are kept for the camera."""
    from deepir.cli.live_camera import camera_frames, open_camera
    from deepir.live.recorder import KeptMaps

    if not options.camera:
        rate = None if options.fast else options.rate
        return _frames(str(options.source), options.settings, rate), None
    camera = stack.enter_context(open_camera(options.camera, options.settings))
    kept = KeptMaps(camera.identity) if camera.identity else None
    return camera_frames(camera, kept if corrector.maps is None else None, corrector), kept


def _frames(source: str, settings: Sequence[str], rate: float | None) -> Iterable[Array]:
    """The frames of standard input or of a recording; at a rate unless it is None."""
    from deepir.errors import ConfigError
    from deepir.io import cropped, stream_data
    from deepir.live.sources import Paced, stream_raw

    config = recording_config(source, settings, RECORDING_SETTINGS)
    if source != STANDARD:
        frames = stream_data(config.data)
    elif config.data.raw is None:
        raise ConfigError(
            "frames on standard input have no header: give their size, for example "
            "data.raw.width=640 data.raw.height=512"
        )
    else:
        frames = cropped(stream_raw(sys.stdin.buffer, config.data.raw), config.data.crop)
    return Paced(frames, rate) if rate else frames


def _open_page(options: _Options, corrector: Corrector, stack: ExitStack) -> Session | None:
    """The session of the page; None if no page is wanted."""
    if options.page is None:
        return None
    from deepir.cli.live_camera import open_page

    source, settings = options.source, options.settings
    config = recording_config(source, settings, RECORDING_SETTINGS) if source else None
    title = source or str(options.camera)
    return stack.enter_context(open_page(corrector, title, config, options.page, options.record_to))


def _play(
    frames: Iterable[Array],
    corrector: Corrector,
    options: _Options,
    session: Session | None,
    stack: ExitStack,
) -> Iterator[CorrectedFrame]:
    """Correct, write and show frame after frame, and print the status every second."""
    from deepir.live.sources import play, virtual_camera

    display = _display(options.settings)
    viewers: list[Callable[[CorrectedFrame], None]] = [session.show] if session else []
    if options.virtual:
        viewers.append(stack.enter_context(virtual_camera(options.rate, display.palette, display.tones)))
    write: Write | None = None
    said = time.monotonic()
    for frame in play(frames, corrector):
        if write is None:
            write = _writer(options.output, frame.raw, display, stack)
        write(frame.corrected)
        for show in viewers:
            show(frame)
        if (now := time.monotonic()) - said > STATUS_EVERY:
            said = now
            dropped = f", {frame.dropped} dropped" if frame.dropped else ""
            notify(f"{frame.status}; {frame.rate:.0f} frames/s, {1000 * frame.delay:.1f} ms{dropped}")
        yield frame


def _finish(
    corrector: Corrector,
    save_maps: Path | None,
    kept: KeptMaps | None,
    session: Session | None,
    ended: str,
) -> None:
    """Write the maps, keep those of a camera, and leave the page open unless it was interrupted."""
    if save_maps and corrector.maps is not None:
        corrector.maps.save(save_maps)
    if kept:
        from deepir.cli.live_camera import keep

        keep(corrector, kept)
    if session and ended:
        from deepir.cli.live_camera import keep_page

        keep_page(session, ended)


def _display(settings: Sequence[str]) -> Output:
    """Palette and tones; of a camera, the other settings are its driver's."""
    shown = [each for each in settings if each.startswith("output.")]
    return recording_config(STANDARD, shown, RECORDING_SETTINGS).output


def _writer(output: str | None, frame: Array, display: Output, stack: ExitStack) -> Write:
    """What takes corrected frames, in the type of the first recorded one."""
    from deepir.io.output.recording import cast, open_writer, output_type

    dtype = output_type(frame.dtype, rounded=True)
    if output is None:
        return lambda corrected: None
    if output == STANDARD:
        stream = standard_output()
        return lambda corrected: _send(stream, cast(corrected, dtype))
    write: Write = stack.enter_context(open_writer(Path(output), dtype, {}, display.palette, display.tones))
    return write


def standard_output() -> IO[bytes]:
    """Standard output, for bytes."""
    return sys.stdout.buffer


def _send(stream: IO[bytes], frame: Array) -> None:
    from deepir.errors import DataError

    try:
        stream.write(frame.tobytes())
        stream.flush()
    except OSError as error:
        raise DataError(f"standard output cannot be written: {error.strerror or error}") from None
