import resource
import shutil
from contextlib import chdir, contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest

from deepir import registry
from deepir.cameras import camera as capturing
from deepir.cameras.camera import Camera
from deepir.cli import main


@pytest.fixture(autouse=True)
def no_plots(monkeypatch):
    """The plots of a comparison take longer than its runs: they have tests of their own."""
    monkeypatch.setattr("deepir.sweep.table.write_plots", lambda path, _: path.write_bytes(b""))


@pytest.fixture
def folder(tmp_path, monkeypatch, burst):
    """An empty working folder with `burst.npz` and `burst_truth.npz` in it."""
    monkeypatch.chdir(tmp_path)
    burst.save(tmp_path / "burst.npz")
    return tmp_path


@pytest.fixture
def deepir(folder, capfd):
    """Run a command line in `folder`: (status, stdout, stderr)."""

    def run(*arguments):
        capfd.readouterr()
        status = main([str(each) for each in arguments])
        out, err = capfd.readouterr()
        return status, out, err

    return run


@pytest.fixture
def refused(deepir, folder):
    """Run a command that is refused: status 2, one line on stderr that holds the words, and nothing is written."""

    def run(arguments, *words):
        before = sorted(folder.rglob("*"))
        status, out, err = deepir(*arguments)
        assert (status, out, err.count("\n")) == (2, "", 1), err
        assert err.startswith("deepir: error: ")
        for each in words:
            assert each in err
        assert sorted(folder.rglob("*")) == before

    return run


@pytest.fixture
def nuc(deepir):
    """`deepir run nuc`, quickly: few iterations, one thread."""

    def run(*arguments):
        return deepir("run", "nuc", "threads=1", "solver.max_iterations=3", *arguments)

    return run


@pytest.fixture(scope="session")
def finished(burst, tmp_path_factory):
    """The folder of a finished run, one that takes no solve."""
    folder = tmp_path_factory.mktemp("finished")
    burst.save(folder / "burst.npz")
    with chdir(folder):
        assert main(["run", "nuc", "threads=1", "data.path=burst.npz", "method=average"]) == 0
    return folder / "runs/nuc"


@pytest.fixture
def averaged(finished, folder):
    """The same run, in the working folder."""
    return Path(shutil.copytree(finished, folder / "runs/nuc"))


@pytest.fixture
def fake(monkeypatch, burst):
    """A camera `fake` that gives what the test puts into `fake.frames`, and then the last again and again."""
    state = SimpleNamespace(frames=list(burst.frames), identity="", closed=0, opened=0)

    class Fake(Camera):
        """A camera that is made up."""

        correction = "switch it off"

        def __init__(self, *, device: str = "/dev/null"):
            state.opened += 1
            self.identity = state.identity
            self.coming = iter(state.frames)
            self.frame = None

        def read(self):
            self.frame = next(self.coming, self.frame)
            if isinstance(self.frame, BaseException):
                raise self.frame
            return self.frame

        def close(self):
            state.closed += 1

    monkeypatch.setitem(registry._components["camera"], "fake", Fake)
    monkeypatch.setattr(capturing, "FRAME_TIMEOUT", 0.2)
    return state


@pytest.fixture
def full_disk():
    """A context in which no file can grow beyond `size` bytes."""

    @contextmanager
    def limit(size):
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)

    return limit
