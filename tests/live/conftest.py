"""A camera that moves over a picture, and a page that shows it."""

import io
import itertools
import json
from contextlib import ExitStack

import numpy as np
import pytest
from knowing import Knowing
from PIL import Image

from deepir.live.corrector import Corrector
from deepir.live.page.server import serve
from deepir.live.page.views import Session
from deepir.live.recorder import Recorder
from deepir.live.sources import play

pytest.importorskip("uvicorn", reason="no uvicorn: pip install 'deepir[live]'")
connect = pytest.importorskip("websockets.sync.client", reason="no websockets: as uvicorn").connect

SIZE = (60, 80)
LENGTH = 90  # frames


@pytest.fixture(scope="session")
def pattern():
    """(h, w), counts."""
    return np.random.default_rng(1).normal(0, 60, SIZE).astype(np.float32)


@pytest.fixture(scope="session")
def frames(pattern):
    """(N, h, w), counts: a picture that passes by behind the pattern."""
    rng = np.random.default_rng(0)
    picture = np.kron(rng.normal(8000, 300, (20, 30)), np.ones((10, 10)))
    at = [(int(60 + 50 * np.sin(k / 9)), int(90 + 80 * np.cos(k / 13))) for k in range(LENGTH)]
    scenes = np.stack([picture[y : y + SIZE[0], x : x + SIZE[1]] for y, x in at])
    return (scenes + pattern + rng.normal(0, 3, scenes.shape)).round().astype(np.uint16)


class Live:
    """A session of which a test shows frame after frame."""

    def __init__(self, frames, pattern, folder):
        self.corrector = Corrector(estimator=Knowing(np.ones_like(pattern), pattern, np.zeros(pattern.shape, bool)))
        self.recorder = Recorder(folder / "recordings")
        self.session = Session(self.corrector, self.recorder, title="drive.avi")
        self.corrected = play(itertools.cycle(frames), self.corrector)

    def show(self, count=1):
        """The next frames; the last of them."""
        for _ in range(count):
            self.session.show(next(self.corrected))
        return self.session.newest


@pytest.fixture
def live(frames, pattern, tmp_path):
    made = Live(frames, pattern, tmp_path)
    yield made
    made.recorder.close()


@pytest.fixture
def address(live):
    """Of the page of `live`."""
    with serve(live.session, "127.0.0.1", 0) as found:
        yield found


class Viewer:
    """Asks for one frame after the other, as the page does."""

    def __init__(self, socket):
        self.socket = socket

    def send(self, **request):
        """Ask for a frame."""
        self.socket.send(json.dumps({"palette": "white-hot", "tones": "percentile"} | request))

    def ask(self, **request):
        """Ask for a frame: its pictures, and how it goes."""
        self.send(**request)
        pictures = []
        while isinstance(part := self.socket.recv(10), bytes):
            pictures.append(np.asarray(Image.open(io.BytesIO(part))))
        return pictures, json.loads(part)


@pytest.fixture
def viewer(address):
    """Makes a viewer of the page."""
    with ExitStack() as stack:

        def look(at=address, **options):
            opened = connect(f"{at}watch".replace("http", "ws"), proxy=None, close_timeout=1, **options)
            return Viewer(stack.enter_context(opened))

        yield look
