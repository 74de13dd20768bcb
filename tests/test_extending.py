"""What docs/how-to/extending.md shows, added to deepir as an outsider would add it."""

import json
import os
import subprocess
import sys
import tomllib

import numpy as np
import pytest
import torch
from documentation import ROOT, blocks, files
from small_problems import whole

import deepir
from deepir import registry
from deepir.assembly import build
from deepir.cli import main
from deepir.config import load
from deepir.effects.shading import low_order_unknowns
from deepir.errors import ConfigError
from deepir.optim.fourier_hessian import has_fourier_model
from deepir.registry import load_plugin
from deepir.simulate import Settings, simulate
from deepir.simulate.scenes.procedural import procedural
from deepir.testing import check_operator

PAGE = ROOT / "docs/how-to/extending.md"
PACKAGE, LENS = "deepir_inpainting", "deepir_lens"
NOISE = 5.0
QUICK = ("threads=1", "output.dir=null")


def install(folder):
    """What `pip install` leaves of the page's package: the modules, and the metadata with its entry point."""
    project = tomllib.loads(files(PAGE)["pyproject.toml"])["project"]
    info = folder / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n")
    groups = project["entry-points"].items()
    lines = [f"[{group}]\n" + "".join(f"{k} = {v}\n" for k, v in entries.items()) for group, entries in groups]
    (info / "entry_points.txt").write_text("".join(lines))


@pytest.fixture(scope="module")
def picture():
    """The scene, where it was recorded, and the frame that came of it."""
    rng = np.random.default_rng(0)
    scene = 8000 + 1000 * procedural(1, (60, 72))
    keep = rng.random(scene.shape) > 0.4
    keep[20:26, 30:36] = False
    return scene, keep, ((scene + NOISE * rng.standard_normal(scene.shape)) * keep).astype(np.float32)


@pytest.fixture
def outside(tmp_path, monkeypatch, picture):
    """A working folder with the page's files and a masked frame."""
    for name, text in files(PAGE).items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    scene, keep, frame = picture
    np.save(tmp_path / "keep.npy", keep.astype(np.uint8))
    np.save(tmp_path / "frame.npy", frame)
    np.save(tmp_path / "truth.npy", scene)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def plugin(outside, own_components, monkeypatch):
    """The page's packages in this process; forgotten afterwards."""
    monkeypatch.syspath_prepend(outside)
    for name in (PACKAGE, LENS):
        load_plugin(name)
    yield
    for name in [name for name in sys.modules if name.split(".")[0] in (PACKAGE, LENS)]:
        del sys.modules[name]


def error(scene, picture, where=None):
    truth, keep, _ = picture
    off = (scene - truth)[~keep if where is None else where]
    return float(np.sqrt(np.mean(off**2)))


def test_a_problem_as_yaml_only_runs_with_a_plugin_that_is_named(plugin, outside, picture):
    assert main(["run", "inpaint.yaml", "--plugin", PACKAGE, "data.truth=truth.npy", "threads=1"]) == 0
    found = np.load("runs/inpaint/result.npz")
    _, keep, frame = picture
    # Not recorded: far better than the zeros of the data, and better than their mean; recorded: kept.
    assert error(found["scene"], picture) < 0.02 * error(frame, picture)
    assert error(found["scene"], picture) < 0.5 * error(np.full(frame.shape, frame[keep].mean()), picture)
    assert error(found["scene"], picture, keep) < 2 * NOISE
    assert np.array_equal(found["keep"], keep)
    assert np.all(found["gain"] == 1)
    assert json.loads((outside / "runs/inpaint/run.json").read_text())["plugins"] == [PACKAGE]


def test_an_installed_plugin_is_found_and_listed(outside):
    install(outside)
    code = "from deepir.cli import main; assert not main(['list']) | main(['check', 'inpaint.yaml', 'problem=inpaint'])"
    environment = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": f"{outside}{os.pathsep}{ROOT}"}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for line in ("  gaps ", "  cosines ", "  curvature ", "  box ", "  inpaint ", "  warp "):
        assert line in done.stdout
    assert "is valid; problem inpaint" in done.stdout


def test_the_operator_is_what_it_says_it_is(plugin):
    (_, example), *_ = [(name, text) for name, text in blocks(PAGE, "python") if "check_operator(" in text]
    exec(example, {})
    operator, x, slots = registry.lookup("operator", "gaps").example()
    assert operator.valid(torch.ones_like(x), **slots).unique().tolist() == [0, 1]
    with pytest.raises(AssertionError, match="not the reference's"):
        check_operator(operator, x, {"keep": slots["keep"] + 1}, reference=lambda x, slots: x)


def test_the_field_keeps_to_what_fields_keep_to(plugin):
    field = registry.lookup("field", "cosines")((1, 1, 12, 15), 1.0, count=5)
    assert torch.equal(field(), torch.ones(1, 1, 12, 15))
    with torch.no_grad():
        field.values.normal_()
    other = registry.lookup("field", "cosines")((1, 1, 12, 15), count=5)
    other.init_from(field().detach())
    assert torch.allclose(other(), field(), atol=1e-5)
    assert field.to(torch.float64)().dtype == torch.float64


@pytest.mark.parametrize("prior", ["cosines", "smooth.yaml"])
def test_the_field_is_a_prior_by_its_name_or_in_a_file(plugin, picture, prior):
    result = deepir.run("inpaint.yaml", *QUICK, f"prior={prior}", "scene.count=20")
    spectrum = np.abs(np.fft.fft2(result.scene - result.scene.mean()))
    assert spectrum[20:40, 24:48].max() < 0.01 * spectrum.max()  # smooth: TV's edges are gone
    assert error(result.scene, picture) < 0.1 * error(picture[2], picture)
    assert ("scene.smooth.weight" in result.metrics["strengths"]) == (prior == "smooth.yaml")


def test_the_field_may_stand_for_any_unknown_or_a_part_of_it(plugin, burst):
    changes = ("physics.sensor.offset.type=column+row+pixel+cosines", "physics.sensor.offset.cosines.count=3")
    result, plain = (
        deepir.run("nuc", *QUICK, "prior=tv", *more, frames=burst.frames, solver={"max_iterations": 20})
        for more in (changes, ())
    )
    assert result.offset.std() > 0.5 * plain.offset.std()
    assert np.abs(result.offset - plain.offset).max() > 1


def test_the_penalty_takes_the_place_of_tv_in_a_setting_or_a_file(plugin, picture, outside):
    swapped = deepir.run("inpaint.yaml", *QUICK, "scene.penalties.tv=null", "scene.penalties.curvature=auto")
    assert list(swapped.metrics["strengths"]) == ["scene.curvature.weight"]
    assert error(swapped.scene, picture) < 0.05 * error(picture[2], picture)
    scene = "scene: {penalties: {tv: null, curvature: {weight: 0.02}}}\n"
    (outside / "straight.yaml").write_text((outside / "inpaint.yaml").read_text() + scene)
    result = deepir.run("straight.yaml", *QUICK, solver={"max_iterations": 2})
    assert result.metrics["strengths"] == {"scene.curvature.weight": pytest.approx(0.02)}


def test_the_problem_definition_runs_its_stages(plugin, picture):
    result = deepir.run("inpaint.yaml", *QUICK, problem="inpaint")
    assert list(dict.fromkeys(row["stage"] for row in result.history)) == ["far", "near"]
    assert error(result.scene, picture) < 0.05 * error(picture[2], picture)


def test_frames_of_a_camera_at_rest_are_used_together(plugin, picture):
    rng = np.random.default_rng(1)
    scene, keep, _ = picture
    frames = (scene + NOISE * rng.standard_normal((4, *scene.shape))) * keep
    changes = (*QUICK, "solver.max_iterations=40", "scene.penalties.tv.weight=0")
    several = deepir.run("inpaint.yaml", *changes, frames=frames)
    assert error(several.scene, picture, keep) == pytest.approx(NOISE / 2, rel=0.1)


def test_noise_that_is_given_sets_the_weight(plugin):
    weights = [
        deepir.run("inpaint.yaml", *QUICK, f"noise.read={read}", solver={"max_iterations": 1}).metrics["strengths"]
        for read in (2, 20)
    ]
    assert weights[0]["scene.tv.weight"] == pytest.approx(10 * weights[1]["scene.tv.weight"])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("physics.gaps.keeep=1", r"no 'keeep'; did you mean 'keep'"),
        ("prior=cosine", r"no prior is called 'cosine'"),
        ("prior=rigid", r"the field 'rigid' does not fit: \(1, 1, 60, 72\) is wanted"),
        ("scene.type=cosines", None),
        ("scene.count=3", r"no option 'count'"),
        ("scene.type=column", r"scene: its part 'column' needs a sigma"),
    ],
)
def test_mistakes_are_named(plugin, change, message):
    if message is None:
        deepir.run("inpaint.yaml", *QUICK, change, solver={"max_iterations": 1})
        return
    with pytest.raises(ConfigError, match=message):
        deepir.run("inpaint.yaml", *QUICK, change)


def test_options_of_a_component_need_no_keyword_marker(own_components):
    from deepir.config.components import make
    from deepir.priors.penalties.base import Penalty

    @registry.register("penalty", "plain")
    class Plain(Penalty):
        """Options without a marker."""

        def __init__(self, weight: float | None = None, width: int = 3):
            super().__init__(weight=weight)
            self.width = width

    assert make("penalty", "plain", {"width": 5}, "here").width == 5
    with pytest.raises(ConfigError, match="did you mean 'width'"):
        make("penalty", "plain", {"widht": 5}, "here")


@pytest.fixture(scope="module")
def vignetted():
    """A burst through a lens that vignettes, the strength of that, and a frame with a flash."""
    pattern = {"gain_pixel": 0.01, "gain_column": 0.0, "dead_pixels": 0.0, "shading": 0.0}
    settings = Settings(n_frames=6, shape=(48, 64), counts=True, **pattern)
    sim = simulate(settings=settings, seed=2)
    rows, columns = (np.linspace(-1, 1, side) for side in settings.shape)
    dark = 1 - 0.1 * (rows[:, None] ** 2 + columns**2) / 2
    frames = (sim.frames * dark).astype(np.float32)
    flashed = frames.copy()
    flashed[3] += 20 * frames.std()
    return frames, flashed


def test_an_operator_between_warp_and_sensor_keeps_the_shortcuts_of_the_solver(plugin, vignetted):
    frames, _ = vignetted
    still = torch.eye(3, dtype=torch.float64).repeat(len(frames), 1, 1)
    problem, _ = build(load("lens.yaml"), whole(frames), still)
    assert has_fourier_model(problem)
    assert low_order_unknowns(problem)[0]
    check_operator(*registry.lookup("operator", "falloff").example())


def test_a_recipe_changes_one_stage_of_nuc_by_name(plugin, vignetted):
    result = deepir.run("lens.yaml", *QUICK, frames=vignetted[0])
    assert result.history[-1]["stage"] == "scene"
    assert 0.0 < float(result.extra["strength"]) < 0.3


def test_an_effect_of_a_plugin_has_a_switch(plugin, vignetted):
    _, flashed = vignetted
    short = ("solver.max_iterations=2", "prior=tv", *QUICK)
    given = (["lens.yaml"], ["lens.yaml", "effects.flash=false"], ["nuc", "effects.flash.min_rise=1.5"])
    found, without, taken = ("".join(deepir.run(*each, *short, frames=flashed).messages) for each in given)
    assert "flash brightens 1 frame" in found
    assert "flash" not in without
    assert "flash" in taken


def test_an_operator_between_warp_and_sensor_is_one_for_all_bursts_of_a_recording(plugin, vignetted):
    frames = np.concatenate([vignetted[0], vignetted[0][::-1]])
    changes = ("physics.falloff={strength: uniform, before: sensor}", "method.count=2", "method.frames=5")
    result = deepir.run("recording", *QUICK, *changes, "prior=tv", frames=frames)
    assert result.scene.shape == (2, 48, 64)
    assert result.extra["strength"] == pytest.approx(0.1, abs=0.1)


def test_the_problem_in_python_finds_the_gain():
    (text,) = (text for _, text in blocks(PAGE, "python") if "op.Warp.around" in text)
    found = {}
    small = text.replace("shape=(48, 64)", "shape=(32, 40)").replace("(96, 128)", "(64, 80)")
    exec(small.replace("1, 1, 48, 64", "1, 1, 32, 40"), found)
    gain = found["problem"].fields["gain"]().detach().numpy()
    assert np.corrcoef(gain.ravel(), found["burst"].truth.gain.ravel())[0, 1] > 0.9
    assert len([line for line in text.splitlines() if line]) <= 18
