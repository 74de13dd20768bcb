"""The commands of the tutorials, the gallery and the page on priors, with smaller frames and fewer iterations."""

import re
import shlex

import pytest
from documentation import ROOT

from deepir.cli import main
from deepir.config import SHIPPED_CONFIGS

FIRST_RECORDING = ROOT / "docs/tutorials/first-recording.md"
TUTORIAL = ROOT / "docs/tutorials/burst.md"
GALLERY = ROOT / "docs/tutorials/gallery.md"
WHICH_PRIOR = ROOT / "docs/how-to/which-prior.md"
SECTIONS = dict(re.findall(r"^## (\w+)\n(.*?)(?=^## |\Z)", GALLERY.read_text(), re.MULTILINE | re.DOTALL))
SHAPE = re.compile(r"shape=\[\d+,\d+\]")


@pytest.fixture(autouse=True)
def few_trials(monkeypatch):
    """The solves within a start take few iterations, as those of the stages do."""
    monkeypatch.setattr("deepir.problems.deblur_lag.TRIAL_ITERATIONS", 3)
    monkeypatch.setattr("deepir.problems.optical_flow.LEVEL_ITERATIONS", 3)


@pytest.fixture
def working_folder(tmp_path, monkeypatch):
    """An empty one."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def command(line, capfd):
    """What `deepir ...` prints, on both streams."""
    program, *arguments = shlex.split(SHAPE.sub("shape=[80,96]", line), comments=True)
    assert program == "deepir"
    quick = ["solver.max_iterations=3"] if arguments[0] in ("run", "analyze") else []
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


def test_the_tutorial_runs_and_prints_what_it_shows(capfd, working_folder):
    printed: set[str] = set()
    for kind, text in shown(TUTORIAL):
        if kind == "text":
            assert {without_figures(line) for line in text.splitlines()} <= printed
            continue
        printed = set()
        for line in commands(text):
            printed |= {without_figures(each) for each in command(line, capfd).splitlines()}


@pytest.mark.slow
def test_the_first_recording_is_corrected_as_shown(capfd, working_folder):
    printed: set[str] = set()
    for kind, text in shown(FIRST_RECORDING):
        if kind == "text":
            assert {without_figures(line) for line in text.splitlines()} <= printed
            continue
        for line in commands(text):
            if line.startswith("deepir ") and "--page" not in line:
                printed |= {without_figures(each) for each in command(line, capfd).splitlines()}
    written = {path.name for path in working_folder.iterdir()}
    assert written >= {"walk_corrected.tif", "walk_corrected_maps.npz", "walk_corrected.png", "again.tif"}


def test_every_shipped_configuration_is_in_the_gallery():
    assert SECTIONS.keys() == {path.stem for path in SHIPPED_CONFIGS.glob("*.yaml")}


@pytest.mark.parametrize("name", SECTIONS)
def test_the_gallery_runs(name, capfd, working_folder):
    simulated, run = commands(re.search(r"^```sh\n(.*?)^```$", SECTIONS[name], re.MULTILINE | re.DOTALL)[1])
    command(simulated, capfd)
    assert run.split()[2] == name
    command(run, capfd)
    assert (working_folder / f"runs/{name}/result.npz").exists()


@pytest.mark.parametrize("name", SECTIONS)
def test_the_gallerys_pictures_are_small(name):
    assert f"(../images/gallery/{name}.png)" in SECTIONS[name]
    assert (ROOT / f"docs/images/gallery/{name}.png").stat().st_size < 60_000


def test_the_priors_that_are_shown_run(capfd, working_folder):
    ((_, text),) = shown(WHICH_PRIOR)
    for line in commands(text):
        command(line, capfd)
    assert {path.name for path in (working_folder / "runs").iterdir()} == {"tv", "red", "tgv", "dip"}
