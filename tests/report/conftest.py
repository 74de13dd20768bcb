"""A run made up, and its report in a browser."""

import json
import re

import numpy as np
import pytest

from deepir.config import load
from deepir.io.radiometry import Linear
from deepir.result import neutral

SIZE = (48, 64)


@pytest.fixture
def result():
    """A radiometric run whose scene is a ramp along x of a count a pixel."""
    rng = np.random.default_rng(0)
    scene = np.tile(8000.0 + np.arange(SIZE[1]), (SIZE[0], 1))
    found = neutral(scene, 3, SIZE, rng.random(SIZE) < 0.01)
    found.radiometry = Linear(0.01, 200.0)
    found.extra = {"scene_kelvin": 200 + 0.01 * found.scene, "stray": rng.normal(0, 1, SIZE), "psf": np.eye(5)}
    found.gain = rng.normal(1, 0.02, SIZE).astype(np.float32)
    found.offset = rng.normal(0, 30, SIZE).astype(np.float32)
    found.uncertainty = {name: np.full(SIZE, 0.5) for name in ("scene", "gain", "offset")}
    found.motion[1, :2, 2], found.motion[2, :2, 2] = (3, -2), (-1, 4)
    found.history = [{"stage": "scene", "iteration": i, "loss": 1000.0 / i, "held_out": 9.0 - i} for i in range(1, 6)]
    found.metrics = {"stop_reason": "converged", "seconds": 1.5, "noise_sigma": 5.0, "held_out_rmse": np.nan}
    return found


@pytest.fixture
def example(result):
    return (result.gain * result.scene + result.offset).astype(np.float32)


@pytest.fixture
def config():
    return load("nuc", ["data.path=camera.npz"])


@pytest.fixture
def data():
    """What the scripts of a page are given."""

    def read(path):
        page = path.read_text(encoding="utf-8")
        return json.loads(re.search(r'id="data">(.*?)</script>', page, re.DOTALL)[1])

    return read


@pytest.fixture
def visit(browser):
    """Open a file as on a desktop, or with other options of a page; it must load nothing and complain of nothing."""
    contexts, wrong = [], []

    def to(path, **options):
        context = browser.new_context(viewport={"width": 1200, "height": 800}, **options)
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda message: wrong.append(message.text))
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("request", lambda request: wrong.append(request.url) if request.url != path.as_uri() else None)
        page.on("dialog", lambda dialog: wrong.append(dialog.message))
        page.goto(path.as_uri())
        page.wait_for_selector("html[data-ready]")
        return page

    yield to
    for context in contexts:
        context.close()
    assert wrong == []
