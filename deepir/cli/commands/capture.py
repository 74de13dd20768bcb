"""`deepir capture`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deepir.cli.arguments import Overwrite, Plugins, check_output_name, held_outputs, load_plugins
from deepir.cli.terminal import echo, notify

if TYPE_CHECKING:
    from deepir.cameras.capture import Captured


def capture(
    out: Annotated[Path, typer.Argument(metavar="OUT.npz", help="The burst.")],
    settings: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="KEY=VALUE", help="Driver settings, for example device=/dev/video2", show_default=False
        ),
    ] = None,
    camera: Annotated[str, typer.Option(help="Driver of the camera: v4l2, boson.")] = "v4l2",
    frames: Annotated[int, typer.Option(min=1, max=1000, help="Number of frames.")] = 10,
    every: Annotated[float, typer.Option(min=0, help="Seconds between frames, at least.")] = 0.4,
    overwrite: Overwrite = False,
    plugin: Plugins = None,
) -> int:
    """Take a burst from a live camera, with advice on its motion: deepir capture burst.npz device=/dev/video2."""
    load_plugins(plugin)
    from deepir.cameras.capture import FREEZE_TIME
    from deepir.cli.terminal import Interrupted, Interruptible, report_aborted
    from deepir.io import write_npz

    check_output_name(out, ".npz")
    try:
        with Interruptible(), held_outputs(out, overwrite=overwrite):
            burst = _capture(camera, settings or (), frames, every)
            write_npz(out, {"frames": burst.frames, "time": burst.times})
    except Interrupted as error:
        return report_aborted(error)
    if burst.longest_freeze > FREEZE_TIME:
        notify(
            f"warning: the picture stood still for {burst.longest_freeze:.1f} s within the burst, as when the shutter "
            "closes: the pattern may have changed then. Switch the automatic correction off, or take the burst again"
        )
    size = " x ".join(map(str, burst.frames.shape[1:]))
    echo(f"{out}: {frames} frame(s) of {size} px, {burst.frames.dtype}, in {burst.times[-1]:.1f} seconds")
    echo(f"does it move enough? deepir analyze {out}")
    echo(f"to correct it: deepir run nuc data.path={out}")
    return 0


def _capture(name: str, settings: Sequence[str], count: int, every: float) -> Captured:
    from deepir.cameras.camera import Array
    from deepir.cameras.capture import advice, capture, motion_span
    from deepir.cli.live_camera import open_camera

    def on_frame(frames: Sequence[Array]) -> None:
        next_move = advice(motion_span(frames)) if len(frames) > 1 else "move the camera, in a small circle"
        notify(f"frame {len(frames)} of {count}; {next_move if len(frames) < count else 'that was the last'}")

    with open_camera(name, settings) as camera:
        return capture(camera, count, every, on_frame)
