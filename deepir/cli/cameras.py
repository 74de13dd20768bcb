"""Commands of cameras, real and simulated: `live`, `capture` and `simulate`."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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
from deepir.cli.terminal import Interruptible, echo, notify
from deepir.errors import ConfigError, DataError

if TYPE_CHECKING:
    from deepir.simulate import Simulation
    from deepir.simulate.recording import Recording

OF_THE_PAGE = ("port", "host", "record_to")  # options of `live`


def capture(
    out: Annotated[Path, typer.Argument(metavar="OUT.npz", help="The burst.")],
    settings: Annotated[
        list[str] | None, typer.Argument(metavar="KEY=VALUE", help="Driver settings, for example device=/dev/video2")
    ] = None,
    camera: Annotated[str, typer.Option(help="Driver of the camera: v4l2, boson.")] = "v4l2",
    frames: Annotated[int, typer.Option(min=1, max=1000, help="Number of frames.")] = 10,
    every: Annotated[float, typer.Option(min=0, help="Seconds between frames, at least.")] = 0.4,
    overwrite: Overwrite = False,
    plugin: Plugins = None,
) -> None:
    """Take a burst from a live camera, with advice on its motion: deepir capture burst.npz device=/dev/video2."""
    load_plugins(plugin)
    from deepir.cameras.camera import FREEZE_TIME, Array, advice, motion_span
    from deepir.cameras.camera import capture as take

    def on_frame(taken: Sequence[Array]) -> None:
        next_move = advice(motion_span(taken)) if len(taken) > 1 else "move the camera, in a small circle"
        notify(f"frame {len(taken)} of {frames}; {next_move if len(taken) < frames else 'that was the last'}")

    with Interruptible(), held_outputs(out, overwrite=overwrite, suffix=".npz"):
        from deepir.cli.live_frames import open_camera
        from deepir.io import write_npz

        with open_camera(camera, settings or ()) as opened:
            burst, times, freeze = take(opened, frames, every, on_frame)
        write_npz(out, {"frames": burst, "time": times})
    if freeze > FREEZE_TIME:
        notify(
            f"warning: the picture stood still for {freeze:.1f} s within the burst, as when the shutter "
            "closes: the pattern may have changed then. Switch the automatic correction off, or take the burst again"
        )
    size = " x ".join(map(str, burst.shape[1:]))
    echo(f"{out}: {frames} frame(s) of {size} px, {burst.dtype}, in {times[-1]:.1f} seconds")
    echo(f"does it move enough? deepir analyze {out}")
    echo(f"to correct it: deepir run nuc data.path={out}")


def simulate(
    out: Annotated[
        Path, typer.Argument(metavar="OUT.npz", help="The burst or recording; its truth goes to OUT_truth.npz.")
    ],
    settings: Annotated[
        list[str] | None,
        typer.Argument(metavar="KEY=VALUE", help="Settings, for example n_frames=8 counts=true; kind=drive"),
    ] = None,
    scene: Annotated[
        str | None,
        typer.Option(
            metavar="PICTURE",
            help="A file, a picture of scikit-image (camera), procedural:SEED or sky:SEED; finer than the detector.",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of motion, pattern, noise and drawn scene.")] = 0,
    overwrite: Overwrite = False,
) -> None:
    """Simulate a burst with known truth: deepir simulate burst.npz n_frames=8 shape=[240,320] counts=true.

    With a kind, a whole recording: deepir simulate drive.npz kind=drive n_frames=300 (walk, pan, tripod, drone).
    """
    from deepir import simulate as bursts
    from deepir.config.overrides import parse_settings
    from deepir.simulate.recording import RecordingSettings, simulate_recording
    from deepir.simulate.scenes.procedural import load_picture
    from deepir.simulate.settings import settings_from_mapping, settings_schema

    given = settings or []
    whole = any(each.partition("=")[0].strip() == "kind" for each in given)
    kind: type[bursts.Settings | RecordingSettings] = RecordingSettings if whole else bursts.Settings
    schema = settings_schema(kind)  # type: ignore[arg-type]  # a class is hashable
    camera = settings_from_mapping(dict(parse_settings(given, schema)), kind)
    if whole and scene is not None:
        raise DataError("--scene: the world of a recording is drawn; leave it out, or leave out kind")
    truth = out.with_name(f"{out.stem}_truth.npz")
    with Interruptible(), held_outputs(out, truth, overwrite=overwrite, suffix=".npz"):
        made: Simulation | Recording
        if isinstance(camera, RecordingSettings):
            made = simulate_recording(camera, seed=seed)
        else:
            made = bursts.simulate(None if scene is None else load_picture(scene), camera, seed=seed)
        made.save(out)
    count, height, width = made.frames.shape
    echo(f"{out}: {count} frames of {height} x {width} px; truth: {truth}")


def live(
    context: typer.Context,
    source: Annotated[
        str | None,
        typer.Argument(metavar="[FILE]", help="A recording; - for raw frames on standard input (data.raw=...)."),
    ] = None,
    settings: ReadingSettings = None,
    camera: Annotated[str | None, typer.Option(help="Driver of a camera in place of a recording: v4l2, boson.")] = None,
    output: Annotated[
        str | None,
        typer.Option(help="A .tif, or an .mp4 to look at; - for raw frames on standard output. Nothing unless given."),
    ] = None,
    rate: Annotated[float, typer.Option(min=0.1, help="Frames a second at which a recording is played.")] = 30.0,
    fast: Annotated[bool, typer.Option("--fast", help="As fast as possible: frames wait for each estimate.")] = False,
    maps: Annotated[Path | None, typer.Option(help="Maps of this camera to begin with.")] = None,
    save_maps: Annotated[Path | None, typer.Option(help="Write the newest maps here at the end.")] = None,
    virtual: Annotated[
        bool, typer.Option("--virtual-camera", help="Show the frames as a camera to video programs.")
    ] = False,
    page: Annotated[
        bool, typer.Option("--page", help="Show the frames in the browser, with controls, until Ctrl-C.")
    ] = False,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port of the page; 0: any free port.")] = 8265,
    host: Annotated[
        str, typer.Option(help="Address of this machine for the page; 0.0.0.0: for others in the network too.")
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
    from deepir.cli import live_frames
    from deepir.config.schema import Output
    from deepir.live.corrector import Corrector
    from deepir.live.estimation import ProcessEstimator, SynchronousEstimator
    from deepir.live.recorder import KeptMaps
    from deepir.live.sources import virtual_camera

    _check(context, source, camera, page=page)
    config = recording_config(source, settings or (), RECORDING_SETTINGS) if source else None
    display = config.output if config else Output()
    files = [Path(each) for each in (output, save_maps) if each and each != live_frames.STANDARD]
    start = read_maps(maps) if maps else None
    session = kept = None
    with (
        held_outputs(*files, overwrite=overwrite, source=source),
        Corrector(start, estimator=SynchronousEstimator() if fast else ProcessEstimator()) as corrector,
        ExitStack() as to_the_end,
    ):
        with Interruptible(), ExitStack() as stack:
            if config:
                frames = live_frames.recording_frames(config, None if fast else rate)
            else:
                opened = stack.enter_context(live_frames.open_camera(str(camera), settings or ()))
                kept = KeptMaps(opened.identity) if opened.identity else None
                frames = live_frames.camera_frames(opened, kept if start is None else None, corrector)
            sinks = [live_frames.status_lines()]
            if output:
                sinks.append(live_frames.writer(output, display, stack))
            if page:
                title, address = source or str(camera), (host, port)
                shown = live_frames.open_page(corrector, title, config, address, record_to)
                session = to_the_end.enter_context(shown)
                sinks.append(session.show)
            if virtual:
                sinks.append(stack.enter_context(virtual_camera(rate, display.palette, display.tones)))
            ended, status = live_frames.correct_all(frames, corrector, sinks, endless=camera is not None)
        if save_maps and corrector.maps is not None:
            corrector.maps.save(save_maps)
        if kept:
            live_frames.keep(corrector, kept)
        if session and ended:
            live_frames.keep_page(session, ended)
    return status


def _check(context: typer.Context, source: str | None, camera: str | None, *, page: bool) -> None:
    """Raise `ConfigError` on options that do not go together."""
    if (source is None) == (camera is None):
        raise ConfigError("give a recording, or a camera: deepir live drive.avi, or deepir live --camera v4l2")
    for option in () if page else OF_THE_PAGE:
        how = context.get_parameter_source(option)
        if how is not None and how.name == "COMMANDLINE":
            raise ConfigError(f"--{option.replace('_', '-')} is an option of the page: add --page")
