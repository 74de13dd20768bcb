"""Configurations: what a file, a preset and `key=value` make together."""

import numpy as np
import pytest

from deepir.config import dump, find, load, prior_names, read, shipped_names
from deepir.config.overrides import parse_yaml
from deepir.errors import ConfigError


def test_a_prior_is_one_line():
    config = load("nuc", ["prior=tv"])
    assert config.scene == {"type": "pixels", "init": "average", "penalties": {"tv": {"weight": "auto"}}}


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


@pytest.mark.parametrize(
    ("pair", "value"),
    [
        ("data.frames=2:5", "2:5"),  # YAML 1.1 reads 125
        ("data.frames=2:", "2:"),  # YAML reads a mapping
        ("data.frames=3", 3),
        ("data.frames=[0,2]", [0, 2]),
        ("data.path=007", "007"),
        ("data.path=a=b.npz", "a=b.npz"),
        ("data.path=[1].npz", "[1].npz"),
        ("data.path=null", None),
        ("data.key=1e3", "1e3"),
    ],
)
def test_values_are_what_they_look_like(pair, value):
    assert getattr(load("nuc", [pair]).data, pair.split("=")[0].split(".")[1]) == value


@pytest.mark.parametrize(
    ("text", "value"),
    [("2:5", "2:5"), ("1e-3", 1e-3), ("010", "010"), ("no", "no"), ("true", True),
     ("2021-01-01", "2021-01-01"), ("-.5", -0.5), ("~", None), ("[1, a]", [1, "a"])],
)  # fmt: skip
def test_yaml_is_plain(text, value):
    assert parse_yaml(text) == value


def test_the_last_of_two_overrides_counts():
    assert load("nuc", ["seed=1", "seed=2"]).seed == 2


def test_a_name_in_place_of_a_component_changes_its_type_only():
    motion = load("nuc", ["physics.warp.motion=affine"]).physics["warp"]["motion"]
    assert motion == {"type": "affine", "init": "register"}


def test_a_number_in_place_of_a_component_is_a_constant():
    assert load("nuc", ["physics.sensor.gain=1"]).physics["sensor"]["gain"] == 1


def test_an_option_of_a_component_that_is_only_named():
    config = load("nuc", ["fidelity=huber", "fidelity.threshold=2"])
    assert config.fidelity == {"type": "huber", "threshold": 2}


def test_null_removes_a_key():
    config = load(
        "nuc", ["prior=tv", "physics.sensor.gain=null", "scene.penalties.tv=null", "data.mask=null"]
    )
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


def test_entries_of_a_list_can_be_changed():
    plan = "solver.plan=[{name: a, steps: [{group: [scene]}]}]"
    config = load("nuc", [plan, "solver.plan.0.iterations=7"])
    assert config.solver.plan[0].iterations == 7
    with pytest.raises(ConfigError, match="no entry '3' in a list of 1"):
        load("nuc", [plan, "solver.plan.3.iterations=7"])


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


def test_a_wrong_override_is_quoted():
    with pytest.raises(ConfigError, match=r"'seed=a': seed = 'a': a whole number is needed"):
        load("nuc", ["threads=1", "seed=a"])


def test_an_interpolation_without_target_is_an_error():
    with pytest.raises(ConfigError, match="nowhere"):
        load({"physics": {"warp": {}}, "seed": "${nowhere}"})


def test_a_value_may_name_another_key():
    found = load("nuc", ["seed=3", "threads=${seed}", "data.path=burst_${seed}.npz"])
    assert (found.threads, found.data.path) == (3, "burst_3.npz")


@pytest.mark.parametrize(
    "text",
    ["${oc.env:TOKEN}", "a_${oc.env:TOKEN,none}.npz", "${oc.decode:${oc.env:TOKEN}}", "\\${oc.env:TOKEN}",
     "${oc.${seed}:TOKEN}", "${ oc.env : TOKEN }", "${seed}${oc.env:TOKEN}", "${"],
)  # fmt: skip
def test_no_value_is_taken_from_the_environment(tmp_path, monkeypatch, text):
    monkeypatch.setenv("TOKEN", "secret")
    (tmp_path / "mine.yaml").write_text(f"physics: {{warp: {{}}}}\ndata: {{path: '{text}'}}\n")
    for given in (
        ("nuc", [f"data.path={text}"]),
        (tmp_path / "mine.yaml",),
        ("nuc", [f"data.frames=['{text}']"]),
    ):
        with pytest.raises(ConfigError) as error:
            load(*given)
        assert "secret" not in str(error.value)
        assert "data: " in str(error.value)


def test_a_name_that_is_not_utf8_is_refused():
    with pytest.raises(ConfigError, match="this name is not UTF-8; rename the file"):
        load("nuc", ["data.path=a\udcff.npz"])


def test_a_shipped_name_is_found_and_a_file_of_that_name_is_not_mistaken(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert find("nuc").name == "nuc.yaml"
    (tmp_path / "nuc").mkdir()
    assert find("nuc").name == "nuc.yaml"


def test_options_from_python_may_hold_paths(tmp_path):
    assert load("nuc", options={"data": {"path": tmp_path / "a.npz"}}).data.path == str(tmp_path / "a.npz")


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
