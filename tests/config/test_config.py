"""Configurations: what a file, a preset and `key=value` make together."""

import numpy as np
import pytest

from deepir.config import dump, find, load, prior_names, read, shipped_names
from deepir.config.overrides import parse_yaml
from deepir.errors import ConfigError


def test_the_file_goes_over_the_preset_and_overrides_over_both():
    base = {"physics": {"warp": {}}, "scene": {"penalties": {"tv": {"weight": 3}}}}
    assert load(base).scene["penalties"]["tv"]["weight"] == 3
    assert load(base, ["scene.penalties.tv.weight=0.5"]).scene["penalties"]["tv"]["weight"] == 0.5
    assert load(base).scene["type"] == "pixels"


@pytest.mark.parametrize("name", shipped_names())
def test_every_shipped_configuration_loads_with_every_prior(name):
    for prior in prior_names():
        assert load(name, [f"prior={prior}"]).prior == prior


def test_a_resolved_configuration_reads_back_the_same(tmp_path):
    changes = [
        "prior=tv",
        "data.frames=2:5",
        "data.path=007",
        "scene.penalties.tv=null",
        "physics.sensor.level=5",
        "noise.read=1e-3",
    ]
    config = load("nuc", changes)
    path = tmp_path / "config.yaml"
    path.write_text(dump(config))
    assert read(path) == config


MOTION = {"type": "affine", "init": "register"}
TV = {"type": "pixels", "init": "average", "penalties": {"tv": {"weight": "auto"}}}
PLAN = "solver.plan=[{name: a, steps: [{group: [scene]}]}]"


@pytest.mark.parametrize(
    ("settings", "key", "value"),
    [
        ("data.frames=2:5", "data.frames", "2:5"),  # YAML 1.1 reads 125
        ("data.frames=2:", "data.frames", "2:"),  # YAML reads a mapping
        ("data.frames=3", "data.frames", 3),
        ("data.frames=[0,2]", "data.frames", [0, 2]),
        ("data.path=007", "data.path", "007"),
        ("data.path=a=b.npz", "data.path", "a=b.npz"),
        ("data.path=[1].npz", "data.path", "[1].npz"),
        ("data.path=null", "data.path", None),
        ("data.key=1e3", "data.key", "1e3"),
        ("prior=tv", "scene", TV),  # a prior is one line
        ("seed=1 & seed=2", "seed", 2),  # the last one counts
        ("seed=3 & threads=${seed}", "threads", 3),  # a value may name another key
        ("seed=3 & data.path=burst_${seed}.npz", "data.path", "burst_3.npz"),
        ("physics.warp.motion=affine", "physics.warp.motion", MOTION),  # a component's name: its type only
        ("physics.sensor.gain=1", "physics.sensor.gain", 1),  # a number is a constant
        ("fidelity=huber & fidelity.threshold=2", "fidelity", {"type": "huber", "threshold": 2}),
        (f"{PLAN} & solver.plan.0.iterations=7", "solver.plan.0.iterations", 7),  # an entry of a list
    ],
)
def test_values_are_what_they_look_like(settings, key, value):
    found = load("nuc", settings.split(" & ")).model_dump()
    for part in key.split("."):
        found = found[int(part) if part.isdecimal() else part]
    assert found == value


@pytest.mark.parametrize(
    ("text", "value"),
    [("2:5", "2:5"), ("1e-3", 1e-3), ("010", "010"), ("no", "no"), ("true", True),
     ("2021-01-01", "2021-01-01"), ("-.5", -0.5), ("~", None), ("[1, a]", [1, "a"])],
)  # fmt: skip
def test_yaml_is_plain(text, value):
    assert parse_yaml(text) == value


def test_null_removes_a_key():
    config = load("nuc", ["prior=tv", "physics.sensor.gain=null", "scene.penalties.tv=null", "data.mask=null"])
    assert list(config.physics["sensor"]) == ["offset", "level"]
    assert config.scene["penalties"] == {}
    assert list(load("nuc", ["physics.sensor=null"]).physics) == ["warp"]


def test_an_empty_stage_in_a_file_has_its_defaults():
    assert load({"physics": {"warp": None, "sensor": {}}}).physics == {"warp": {}, "sensor": {}}


@pytest.mark.parametrize(
    ("target", "order"), [("sensor", ["warp", "blur", "sensor"]), ("warp", ["blur", "warp", "sensor"])]
)
def test_an_added_stage_goes_where_it_says(target, order):
    config = load("nuc", [f"physics.blur.before={target}"])
    assert list(config.physics) == order
    assert config.physics["blur"] == {}


def test_a_misspelt_key_in_a_file_names_the_file(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("physics: {warp: {}}\nsolver: {max_iteration: 3}\n")
    with pytest.raises(ConfigError, match=r"mine\.yaml: no option 'solver\.max_iteration'; did you mean"):
        load(path)


def test_what_is_wrong_with_a_file_of_a_prior_names_the_file(tmp_path):
    path = tmp_path / "smooth.yaml"
    with pytest.raises(ConfigError, match=r"smooth\.yaml: no such file"):
        load("nuc", [f"prior={path}"])
    path.write_text("scen: {type: grid}\n")
    with pytest.raises(ConfigError, match=r"smooth\.yaml: no option 'scen'; a prior's file holds `scene:`"):
        load("nuc", [f"prior={path}"])


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        (["threads=1", "seed=a"], r"'seed=a': seed = 'a': a whole number is needed"),
        (["seed=${nowhere}"], "nowhere"),
        ([PLAN, "solver.plan.3.iterations=7"], "no entry '3' in a list of 1"),
        (["data.path=a\udcff.npz"], "this name is not UTF-8; rename the file"),
    ],
)
def test_a_wrong_override_is_quoted(settings, says):
    with pytest.raises(ConfigError, match=says):
        load("nuc", settings)


@pytest.mark.parametrize(
    "text",
    ["${oc.env:TOKEN}", "a_${oc.env:TOKEN,none}.npz", "${oc.decode:${oc.env:TOKEN}}", "\\${oc.env:TOKEN}",
     "${oc.${seed}:TOKEN}", "${ oc.env : TOKEN }", "${seed}${oc.env:TOKEN}", "${"],
)  # fmt: skip
def test_no_value_is_taken_from_the_environment(tmp_path, monkeypatch, text):
    monkeypatch.setenv("TOKEN", "secret")
    (tmp_path / "mine.yaml").write_text(f"physics: {{warp: {{}}}}\ndata: {{path: '{text}'}}\n")
    for given in (("nuc", [f"data.path={text}"]), (tmp_path / "mine.yaml",), ("nuc", [f"data.frames=['{text}']"])):
        with pytest.raises(ConfigError) as error:
            load(*given)
        assert "secret" not in str(error.value)
        assert "data: " in str(error.value)


def test_a_shipped_name_is_found_and_a_file_of_that_name_is_not_mistaken(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert find("nuc").name == "nuc.yaml"
    (tmp_path / "nuc").mkdir()
    assert find("nuc").name == "nuc.yaml"


def test_options_from_python_may_hold_paths_and_scalars_of_numpy(tmp_path):
    options = {"data": {"path": tmp_path / "a.npz"}, "noise": {"read": np.float64(0.5)}, "seed": np.int64(3)}
    for config in (load("nuc", options=options), load({"physics": {}} | options)):
        assert (config.data.path, config.noise.read, config.seed) == (str(tmp_path / "a.npz"), 0.5, 3)


def test_no_import_path_is_a_type():
    from deepir.api import run

    frames = np.random.default_rng(0).random((3, 32, 32))
    for key in ("scene.type", "physics.warp.motion.type", "method", "problem"):
        with pytest.raises(ConfigError, match=r"is called 'os\.system'"):
            run("nuc", f"{key}=os.system", frames=frames)


def test_a_prior_that_is_taken_away_is_the_default_and_not_that_of_the_file():
    """What runs is what is recorded: read back, it is the same scene."""
    config = load("nuc", ["prior=null"])
    assert (config.prior, config.scene) == ("tv", load("nuc", ["prior=tv"]).scene)
    assert load(parse_yaml(dump(config))).scene == config.scene
