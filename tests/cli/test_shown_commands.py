"""The commands of the pages, with smaller frames and fewer iterations: they run, and print what is shown."""

import re
import shlex

import numpy as np
import pytest
import tifffile
from documentation import ROOT

from deepir.cli import main
from deepir.config import SHIPPED_CONFIGS, load

FIRST_RECORDING = ROOT / "docs/tutorials/first-recording.md"
TUTORIAL = ROOT / "docs/tutorials/burst.md"
GALLERY = ROOT / "docs/tutorials/gallery.md"
WHICH_PRIOR = ROOT / "docs/how-to/which-prior.md"
SECTIONS = dict(re.findall(r"^## (\w+)\n(.*?)(?=^## |\Z)", GALLERY.read_text(), re.MULTILINE | re.DOTALL))
PROBLEMS = ["super-resolution", "narcissus", "deconvolution", "thermal-lag", "flow", "many-views"]  # pages of problems
SHAPE = re.compile(r"shape=\[\d+,\d+\]")


pytestmark = pytest.mark.usefixtures("few_trials")


@pytest.fixture
def working_folder(tmp_path, monkeypatch):
    """An empty one."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def command(line, capfd, shape="[80,96]"):
    """What `deepir ...` prints, on both streams, for frames of that shape."""
    program, *arguments = shlex.split(SHAPE.sub(f"shape={shape}", line), comments=True)
    assert program == "deepir"
    quick = ["solver.max_iterations=3"] if arguments[0] in ("run", "analyze") or "--burst" in arguments else []
    capfd.readouterr()
    status = main([*arguments, *quick])
    printed = "".join(capfd.readouterr())
    assert status == 0, printed
    return printed


def shown(page):
    """(kind, text) of the page's commands and of what they print, in order."""
    return re.findall(r"^```(sh|text)\n(.*?)^```$", page.read_text(), re.MULTILINE | re.DOTALL)


def commands(text):
    return text.replace("\\\n", " ").splitlines()


def without_figures(line):
    """A line without its figures and how a solve ends, which are others on smaller frames."""
    return re.sub(r"converged|stopped as planned|[\d.]+(e[+-]\d+)?", "#", line.strip())


@pytest.mark.parametrize(
    "page", [TUTORIAL, pytest.param(FIRST_RECORDING, marks=pytest.mark.slow)], ids=lambda page: page.stem
)
def test_a_tutorial_runs_and_prints_what_it_shows(page, capfd, working_folder):
    printed: set[str] = set()
    for kind, text in shown(page):
        if kind == "text":
            assert {without_figures(line) for line in text.splitlines()} <= printed
            continue
        for line in commands(text):
            if line.startswith("deepir ") and "--page" not in line:
                printed |= {without_figures(each) for each in command(line, capfd).splitlines()}


def test_every_shipped_configuration_is_in_the_gallery():
    assert SECTIONS.keys() == {path.stem for path in SHIPPED_CONFIGS.glob("*.yaml")}


@pytest.mark.parametrize("name", SECTIONS)
def test_the_gallery_runs(name, capfd, working_folder):
    text = SECTIONS[name].replace("n_frames=120", "n_frames=60")
    simulated, run = commands(re.search(r"^```sh\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)[1])
    # Two cameras see the same, and the coarse one's field of view stays; a dense motion wants frames of some size.
    shape = "[80,96]" if name in ("two_cameras", "flow") else "[48,64]"
    command(simulated, capfd, shape)
    assert run.split()[2] == name
    command(run, capfd, shape)
    assert (working_folder / f"runs/{name}/result.npz").exists()


@pytest.mark.parametrize("name", SECTIONS)
def test_the_gallerys_pictures_are_small(name):
    assert f"(../images/gallery/{name}.png)" in SECTIONS[name]
    assert (ROOT / f"docs/images/gallery/{name}.png").stat().st_size < 60_000


def test_the_priors_that_are_shown_run(capfd, working_folder):
    ((_, text),) = shown(WHICH_PRIOR)
    for line in commands(text):
        command(line, capfd, "[48,64]")
    assert {path.name for path in (working_folder / "runs").iterdir()} == {"tv", "red", "tgv", "dip"}


def commands_of_problem(page):
    """The arguments of each `deepir ...` in the blocks of a problem's page, frames made small."""
    text = "".join(text for kind, text in shown(ROOT / f"docs/explanation/{page}.md") if kind == "sh")
    lines = commands(SHAPE.sub("shape=[48,64]", text))
    return [shlex.split(each, comments=True)[1:] for each in lines if each.startswith("deepir ")]


@pytest.mark.parametrize("page", PROBLEMS)
def test_each_problem_has_a_page_with_commands_whose_settings_are_taken(page):
    runs = [each for each in commands_of_problem(page) if each[0] == "run"]
    assert runs
    for _, name, *settings in runs:
        load(name, [each for each in settings if "=" in each and not each.startswith("--")])


@pytest.fixture
def inputs(working_folder, burst):
    """What the commands of the problems' pages read."""
    burst.save(working_folder / "burst.npz")
    for name in ("frames", "video"):
        np.savez(f"{name}.npz", frames=np.concatenate([burst.frames] * 7))
    tifffile.imwrite("picture.tiff", burst.frames[0])
    for name, level in (("cold", 8000), ("hot", 9000)):
        noise = np.random.default_rng(level).normal(0, 5, (3, 48, 64))  # of the shape that is simulated
        np.save(f"{name}.npy", (level + noise).astype(np.uint16))


@pytest.mark.slow
@pytest.mark.parametrize("page", PROBLEMS)
def test_the_commands_of_a_problems_page_run(page, inputs, capfd):
    for number, arguments in enumerate(commands_of_problem(page)):
        own = [] if any("output.dir" in each for each in arguments) else [f"output.dir=runs/{number}"]
        quick = ["solver.max_iterations=1", "threads=1", *own]
        more = quick if arguments[0] == "run" else ["--overwrite"]
        assert main([*arguments, *more]) == 0, (arguments, capfd.readouterr().err)
