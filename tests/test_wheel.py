"""The wheel is complete: deepir runs from it with no source tree at hand."""

import os
import subprocess
import sys
import zipfile

import pytest
from documentation import ROOT

CONFIGS = ROOT / "configs"


@pytest.fixture(scope="session")
def wheel(tmp_path_factory):
    """The wheel, built from the sources by their back end."""
    pytest.importorskip("hatchling", reason="no hatchling: pip install 'deepir[dev]'")
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, capture_output=True, check=True)
    return next(folder.glob("*.whl"))


@pytest.fixture(scope="session")
def installed(wheel, tmp_path_factory):
    """Runs Python with the wheel alone in an empty folder: (status, stdout)."""
    target, elsewhere = tmp_path_factory.mktemp("site"), tmp_path_factory.mktemp("elsewhere")
    options = ["--quiet", "--no-deps", "--no-index", "--no-compile", "--disable-pip-version-check"]
    command = [sys.executable, "-m", "pip", "install", *options, "--target", str(target), str(wheel)]
    subprocess.run(command, capture_output=True, check=True)
    environment = os.environ | {"PYTHONPATH": str(target)}

    def run(*arguments):
        ended = subprocess.run(
            [sys.executable, *arguments], cwd=elsewhere, env=environment, capture_output=True, text=True, check=False
        )
        assert ended.returncode == 0, ended.stderr
        return ended.stdout

    assert run("-c", "import deepir; print(deepir.__file__)").startswith(str(target))
    run.folder = elsewhere
    return run


def files_of(folder):
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def test_the_wheel_holds_all_files_of_the_package(wheel):
    with zipfile.ZipFile(wheel) as archive:
        held = {name.removeprefix("deepir/") for name in archive.namelist() if name.startswith("deepir/")}
    sources = {each for each in files_of(ROOT / "deepir") if "__pycache__" not in each}
    assert held == sources | {f"configs/{each}" for each in files_of(CONFIGS)}


def test_commands_work_from_the_wheel_alone(installed):
    installed("-m", "deepir", "simulate", "burst.npz", "n_frames=3", "shape=[40,48]")
    assert "3 frame(s)" in installed("-m", "deepir", "check", "burst.npz")


@pytest.mark.slow  # its kernels are compiled anew
def test_a_run_works_from_the_wheel_alone(installed):
    installed("-m", "deepir", "run", "nuc", "data.simulate.shape=[40,48]", "data.simulate.n_frames=3", "output.dir=run")
    assert {"result.npz", "summary.png", "report.html", "metrics.json"} <= files_of(installed.folder / "run")
