"""`deepir demo`."""

from __future__ import annotations

from pathlib import Path

from deepir.cli.terminal import echo

DEMO_FOLDER = Path("runs/demo")  # where the demo writes
DEMO_SHAPE = (256, 320)  # height and width of its frames, px


def demo() -> int:
    """Correct a simulated burst of five frames in counts; results and pictures in runs/demo/."""
    from deepir.cli.commands.run import run_and_store
    from deepir.config import load
    from deepir.simulate import Settings, simulate
    from deepir.storage.folder import RunFolder

    folder = RunFolder(DEMO_FOLDER)
    with folder.lock():
        folder.check_free(overwrite=True)
        burst = simulate(None, Settings(n_frames=5, shape=DEMO_SHAPE, counts=True, max_rotation=1.0), seed=0)
        path, truth = burst.save(DEMO_FOLDER / "burst.npz")
    echo(f"simulated {path}; correcting it with: deepir run nuc data.path={path}")
    config = load("nuc", [f"data.path={path}", f"data.truth={truth}"])
    status = run_and_store(config, DEMO_FOLDER, overwrite=True, plugins=[])
    if status == 0:
        _compare()
    return status


def _compare() -> None:
    """PSNR of one frame, of the registered average, and of the result."""
    import json

    from deepir.config import read
    from deepir.metrics import scores
    from deepir.runner import execute, prepare

    config = read(DEMO_FOLDER / "config.yaml").model_copy(update={"method": "average"})
    data = prepare(config)
    rows = {
        "one frame": scores(data.frames[0], data.truth["scene"]),
        "registered average": execute(config, data).metrics,
        "deepir": json.loads((DEMO_FOLDER / "metrics.json").read_text(encoding="utf-8")),
    }
    echo("PSNR after the best gain and level:")
    for name, found in rows.items():
        echo(f"  {name:<20} {found['psnr_aligned']:6.2f} dB")
