"""Shared by all tests."""

import logging
import os
import shutil
from pathlib import Path

# The tests share the cores among processes: threads that wait for each other take them away.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
import torch

torch.set_num_threads(1)
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")


@pytest.fixture(autouse=True)
def seed():
    """Every test draws the same numbers, whichever run before it."""
    torch.manual_seed(0)


@pytest.fixture(scope="session", autouse=True)
def quiet_compiler():
    """A cold cache of compiled kernels does not change what commands print; the notice has a test of its own."""
    from deepir.kernels import ahead

    ahead.log = logging.Logger("quiet", logging.CRITICAL)


@pytest.fixture
def own_components(monkeypatch):
    """What a test registers is forgotten afterwards; all that deepir has is loaded before."""
    from deepir import registry

    known = {kind: dict(registry.components(kind)) for kind in registry.COMPONENT_MODULES}
    monkeypatch.setattr(registry, "_components", known)


@pytest.fixture(scope="session")
def burst():
    """A simulated burst with its truth: three frames of 40 x 48 px in counts."""
    from deepir.simulate import Settings, simulate

    camera = Settings(n_frames=3, shape=(40, 48), counts=True, max_shift=4.0, motion="shift", dead_pixels=0.0)
    return simulate(None, camera, seed=3)


@pytest.fixture(scope="session")
def browser():
    """A headless Chromium; the test is skipped where there is none."""
    if CHROMIUM is None:
        pytest.skip("no Chromium here: apt-get install chromium")
    api = pytest.importorskip("playwright.sync_api", reason="no playwright: pip install 'deepir[dev]'")
    with api.sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield found
        found.close()


@pytest.fixture
def benchmarks(monkeypatch):
    """The scripts of `benchmarks/` can be imported."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent.parent / "benchmarks"))


@pytest.fixture
def few_trials(monkeypatch):
    """The solves within a start, which no setting shortens, take the same steps, less often."""
    monkeypatch.setattr("deepir.problems.deblur_lag.TRIAL_ITERATIONS", 3)
    monkeypatch.setattr("deepir.problems.optical_flow.LEVEL_ITERATIONS", 3)


@pytest.fixture
def small_nuc():
    """Makes a small burst with its problem: warp and sensor, gain and offset as parts, TV or ridge.

    `make(...)` returns the problem, at the true motion and with the scene near the true one.
    """
    from deepir.fields.base import Pixels
    from deepir.fields.constant import Constant
    from deepir.fields.motion import Shift
    from deepir.fields.sensor_maps import Column, Pixel, Row, SumField
    from deepir.operators import Sensor, Warp
    from deepir.priors.penalties.distance import Ridge
    from deepir.priors.penalties.tv import TV
    from deepir.problem import Problem

    def make(*, pedestal=50.0, quadratic=False, noise=0.1, n_frames=3, size=(10, 12), dtype=torch.float64):
        canvas = (size[0] + 6, size[1] + 6)
        chain = Sensor() @ Warp(size, canvas, (3, 3))
        maps, motions = (1, 1, *size), (n_frames, 3, 3)

        def parts(neutral, sigmas):
            kinds = zip((Column, Row, Pixel), sigmas, strict=True)
            return SumField(maps, neutral, {k.__name__.lower(): k(maps, sigma=s) for k, s in kinds})

        fields = {
            "scene": Pixels((1, 1, *canvas)),
            "motion": Shift(motions, size=size),
            "gain": parts(1.0, (0.02, 0.01, 0.02)),
            "offset": parts(0.0, (0.5, 0.2, 0.3)),
            "level": Constant((n_frames, 1, 1, 1)),
        }
        y, x = torch.meshgrid(*(torch.arange(side) / 3.0 for side in canvas), indexing="ij")
        scene = pedestal + 5 * ((x.sin() + (1.3 * y).cos()) > 0.4) + x.cos() * y.sin()
        motion = torch.eye(3).repeat(n_frames, 1, 1)
        motion[1:, :2, 2] = 4 * torch.rand(n_frames - 1, 2) - 2
        truth = {
            "scene": scene[None, None],
            "motion": motion,
            "gain": 1 + 0.02 * torch.randn(maps) + 0.02 * torch.randn(1, 1, 1, size[1]),
            "offset": 0.3 * torch.randn(maps) + 0.2 * torch.randn(1, 1, size[0], 1),
        }
        sensor = {"sensor.gain": truth["gain"], "sensor.offset": truth["offset"]}
        still = {"sensor.level": torch.zeros(n_frames, 1, 1, 1)}
        data = chain(truth["scene"], **{"warp.motion": motion}, **sensor, **still)
        data = data + noise * torch.randn_like(data)
        penalty = Ridge(weight=4.0, center=pedestal) if quadratic else TV(weight=2.0)
        precision = torch.full_like(data, 1 / 0.1**2)
        problem = Problem(chain, fields, data, precision, penalties={"scene": {"prior": penalty}}).to(dtype)
        fields["motion"].init_from(motion)
        fields["scene"].init_from(scene[None, None] + 0.5 * torch.randn(1, 1, *canvas))
        problem.truth = truth
        return problem

    return make
