"""The commands of the problems' pages: their settings are taken, and, among the slow tests, they run."""

import re
import shlex

import numpy as np
import pytest
import tifffile
from documentation import ROOT

from deepir.cli import main
from deepir.config import load

PAGES = ["super-resolution", "narcissus", "deconvolution", "thermal-lag", "flow", "many-views"]
QUICK = ["solver.max_iterations=1", "threads=1"]


def commands(page):
    """The arguments of each `deepir ...` in a page's blocks, frames made small."""
    text = (ROOT / f"docs/explanation/{page}.md").read_text()
    lines = "".join(re.findall(r"^```sh\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)).replace("\\\n", " ")
    small = re.sub(r"shape=\[\d+,\d+\]", "shape=[48,64]", lines)
    return [shlex.split(each, comments=True)[1:] for each in small.splitlines() if each.startswith("deepir ")]


@pytest.mark.parametrize("page", PAGES)
def test_each_problem_has_a_page_with_commands_whose_settings_are_taken(page):
    shown = [each for each in commands(page) if each[0] == "run"]
    assert shown
    for _, name, *settings in shown:
        load(name, [each for each in settings if "=" in each and not each.startswith("--")])


@pytest.fixture
def files(tmp_path, monkeypatch, simulation):
    """A working folder with what the pages' commands read."""
    monkeypatch.chdir(tmp_path)
    frames = simulation.frames
    simulation.save(tmp_path / "burst.npz")
    for name in ("frames", "video"):
        np.savez(tmp_path / f"{name}.npz", frames=np.concatenate([frames] * 7))
    tifffile.imwrite(tmp_path / "picture.tiff", frames[0])
    for name, level in (("cold", 8000), ("hot", 9000)):
        noise = np.random.default_rng(level).normal(0, 5, (3, 48, 64))  # of `shape`, as in `commands`
        np.save(tmp_path / f"{name}.npy", (level + noise).astype(np.uint16))
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_the_commands_of_a_page_run(page, files, capfd):
    for number, arguments in enumerate(commands(page)):
        own = [] if any("output.dir" in each for each in arguments) else [f"output.dir=runs/{number}"]
        more = [*QUICK, *own] if arguments[0] == "run" else ["--overwrite"]
        assert main([*arguments, *more]) == 0, (arguments, capfd.readouterr().err)
