"""The commands `capture` and `simulate`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deepir.cli.arguments import Overwrite, Plugins, held_outputs, load_plugins
from deepir.cli.terminal import Interruptible, echo, notify

if TYPE_CHECKING:
    from deepir.cameras.camera import Captured
    from deepir.simulate import Simulation
    from deepir.simulate.recording import Recording


def capture(
    out: Annotated[Path, typer.Argument(metavar="OUT.npz", help="The burst.")],
    settings: Annotated[
        list[str] | None,
        typer.Argument(metavar="KEY=VALUE", help="Driver settings, for example device=/dev/video2"),
    ] = None,
    camera: Annotated[str, typer.Option(help="Driver of the camera: v4l2, boson.")] = "v4l2",
    frames: Annotated[int, typer.Option(min=1, max=1000, help="Number of frames.")] = 10,
    every: Annotated[float, typer.Option(min=0, help="Seconds between frames, at least.")] = 0.4,
    overwrite: Overwrite = False,
    plugin: Plugins = None,
) -> None:
    """Take a burst from a live camera, with advice on its motion: deepir capture burst.npz device=/dev/video2."""
    load_plugins(plugin)
    from deepir.cameras.camera import FREEZE_TIME
    from deepir.io import write_npz

    with Interruptible(), held_outputs(out, overwrite=overwrite, suffix=".npz"):
        burst = _capture(camera, settings or (), frames, every)
        write_npz(out, {"frames": burst.frames, "time": burst.times})
    if burst.longest_freeze > FREEZE_TIME:
        notify(
            f"warning: the picture stood still for {burst.longest_freeze:.1f} s within the burst, as when the shutter "
            "closes: the pattern may have changed then. Switch the automatic correction off, or take the burst again"
        )
    size = " x ".join(map(str, burst.frames.shape[1:]))
    echo(f"{out}: {frames} frame(s) of {size} px, {burst.frames.dtype}, in {burst.times[-1]:.1f} seconds")
    echo(f"does it move enough? deepir analyze {out}")
    echo(f"to correct it: deepir run nuc data.path={out}")


def _capture(name: str, settings: Sequence[str], count: int, every: float) -> Captured:
    from deepir.cameras.camera import Array, advice, capture, motion_span
    from deepir.cli.live_frames import open_camera

    def on_frame(frames: Sequence[Array]) -> None:
        next_move = advice(motion_span(frames)) if len(frames) > 1 else "move the camera, in a small circle"
        notify(f"frame {len(frames)} of {count}; {next_move if len(frames) < count else 'that was the last'}")

    with open_camera(name, settings) as camera:
        return capture(camera, count, every, on_frame)


def simulate(
    out: Annotated[
        Path,
        typer.Argument(metavar="OUT.npz", help="The burst or recording; its truth goes to OUT_truth.npz."),
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
    from deepir.errors import DataError

    given = settings or []
    whole = any(each.partition("=")[0].strip() == "kind" for each in given)
    simulated: Callable[[], Simulation | Recording]
    simulated = _recording(given, seed) if whole else _burst(given, scene, seed)
    if whole and scene is not None:
        raise DataError("--scene: the world of a recording is drawn; leave it out, or leave out kind")
    truth = out.with_name(f"{out.stem}_truth.npz")
    with Interruptible(), held_outputs(out, truth, overwrite=overwrite, suffix=".npz"):
        made = simulated()
        made.save(out)
    count, height, width = made.frames.shape
    echo(f"{out}: {count} frames of {height} x {width} px; truth: {truth}")


def _burst(settings: list[str], scene: str | None, seed: int) -> Callable[[], Simulation]:
    """Check the settings of a burst; a function that simulates it."""
    from deepir import simulate as camera
    from deepir.config.overrides import parse_settings
    from deepir.simulate.scenes.procedural import load_picture
    from deepir.simulate.settings import settings_from_mapping, settings_schema

    pairs = dict(parse_settings(settings, settings_schema(camera.Settings)))
    burst = settings_from_mapping(pairs, camera.Settings)
    return lambda: camera.simulate(None if scene is None else load_picture(scene), burst, seed=seed)


def _recording(settings: list[str], seed: int) -> Callable[[], Recording]:
    """Check the settings of a whole recording; a function that simulates it."""
    from deepir.config.overrides import parse_settings
    from deepir.simulate.recording import RecordingSettings, simulate_recording
    from deepir.simulate.settings import settings_from_mapping, settings_schema

    pairs = dict(parse_settings(settings, settings_schema(RecordingSettings)))
    recording = settings_from_mapping(pairs, RecordingSettings)
    return lambda: simulate_recording(recording, seed=seed)
