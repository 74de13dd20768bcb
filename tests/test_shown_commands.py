"""The commands of the tutorial and the gallery, one after the other, on smaller frames than the pages'."""

import re
import shlex

import pytest
import torch
from documentation import ROOT

from deepir.cli import main
from deepir.config import SHIPPED

TUTORIAL = ROOT / "docs/tutorial.md"
GALLERY = ROOT / "docs/gallery.md"
SECTIONS = dict(re.findall(r"^## (\w+)\n(.*?)(?=^## |\Z)", GALLERY.read_text(), re.MULTILINE | re.DOTALL))
SHAPE = re.compile(r"shape=\[\d+,\d+\]")


@pytest.fixture(autouse=True)
def working_folder(tmp_path, monkeypatch):
    """An empty one; one thread, for small arrays gain nothing from more."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    torch.set_num_threads(before)


def command(line, capfd):
    """What `deepir ...` prints, on both streams, and its exit status; bursts are simulated small."""
    program, *arguments = shlex.split(SHAPE.sub("shape=[80,96]", line), comments=True)
    assert program == "deepir"
    capfd.readouterr()
    status = main(arguments)
    return status, "".join(capfd.readouterr())


def shown(page):
    """(kind, text) of the page's commands and of what they print, in order."""
    return re.findall(r"^```(sh|text)\n(.*?)^```$", page.read_text(), re.MULTILINE | re.DOTALL)


def commands(text):
    return text.replace("\\\n", " ").splitlines()


def told(line):
    """A line without its figures, which are other ones on smaller frames."""
    return re.sub(r"[\d.]+(e[+-]\d+)?", "#", line.strip())


def test_the_tutorial_runs_and_prints_what_it_shows(capfd):
    printed: set[str] = set()
    for kind, text in shown(TUTORIAL):
        if kind == "text":
            assert {told(line) for line in text.splitlines()} <= printed
            continue
        printed = set()
        for line in commands(text):
            status, out = command(line, capfd)
            assert status == 0, out
            printed |= {told(each) for each in out.splitlines()}


def test_every_shipped_configuration_is_in_the_gallery():
    assert SECTIONS.keys() == {path.stem for path in SHIPPED.glob("*.yaml")}


@pytest.mark.parametrize("name", SECTIONS)
def test_the_gallery_runs(name, capfd, working_folder):
    simulated, run = commands(re.search(r"^```sh\n(.*?)^```$", SECTIONS[name], re.MULTILINE | re.DOTALL)[1])
    status, printed = command(simulated, capfd)
    assert status == 0, printed
    assert run.split()[2] == name
    status, printed = command(f"{run} solver.max_iterations=2", capfd)
    assert status == 0, printed
    assert (working_folder / f"runs/{name}/result.npz").exists()


@pytest.mark.parametrize("name", SECTIONS)
def test_the_gallerys_pictures_are_small(name):
    assert f"(images/gallery/{name}.png)" in SECTIONS[name]
    assert (ROOT / f"docs/images/gallery/{name}.png").stat().st_size < 60_000
