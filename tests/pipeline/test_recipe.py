"""Effects are switched by name; stages may have any name, what they are is their type."""

import numpy as np
import pytest

import deepir
from deepir.config import load
from deepir.effects.effect import Effect
from deepir.errors import ConfigError
from deepir.pipeline.schedule import make_recipe
from deepir.registry import components
from deepir.simulate import Settings, simulate

EFFECTS = components("effect")


def names(recipe):
    known = {kind: name for name, kind in EFFECTS.items()}
    return [known[type(effect)] for effect in recipe.effects]


def test_a_problem_has_the_effects_that_it_lists_but_those_that_are_switched_off():
    listed = list(type(make_recipe(load("nuc"))).effect_names)
    assert names(make_recipe(load("nuc"))) == listed
    without = names(make_recipe(load("nuc", ["effects.vignetting=false"])))
    assert without == [name for name in listed if name != "vignetting"]
    assert names(make_recipe(load("sr", ["effects.unobserved=true"])))[-1] == "unobserved"  # not listed: last
    recipe = make_recipe(load("nuc", ["effects.moving_objects.min_contrast=7"]))
    (found,) = (effect for effect in recipe.effects if type(effect) is EFFECTS["moving_objects"])
    assert found.min_contrast == 7


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("effects.vigneting=false", "vignetting"),
        ("effects.vignetting.min_frame=3", "min_frames"),
        ("effects.vignetting=3", "effects"),
    ],
)
def test_a_misspelt_effect_or_option_names_the_nearest(setting, message):
    with pytest.raises(ConfigError, match=message):
        make_recipe(load("nuc", [setting]))


@pytest.mark.parametrize("kind", EFFECTS.values(), ids=EFFECTS)
def test_every_effect_has_defaults_and_documented_options(kind):
    effect = kind()
    assert isinstance(effect, Effect)
    assert all(f"{option}:" in kind.__doc__ for option in effect.__dataclass_fields__)


def test_every_effect_of_nuc_can_be_left_out(burst):
    off = [f"effects.{name}=false" for name in type(make_recipe(load("nuc"))).effect_names]
    result = deepir.run("nuc", *off, "prior=tv", "solver.max_iterations=3", frames=burst.frames)
    assert np.isfinite(result.scene).all()


def test_without_its_effect_a_moving_object_stays_in_the_scene():
    sim = simulate(settings=Settings(shape=(96, 112), walker=0.4, n_frames=6), seed=8)
    off = ("effects.moving_objects=false", "prior=tv", "solver.max_iterations=12")
    assert "moving" not in deepir.run("nuc", *off, frames=sim.frames).extra


PARTS = {"type": "column+row+shading+pixel"}
PHYSICS = {
    "pose": {"type": "warp", "motion": {"type": "auto", "init": "register"}},
    "camera": {"type": "sensor", "gain": PARTS, "offset": PARTS, "level": {"type": "drift+row_noise+column_noise"}},
}


def test_a_warp_and_a_sensor_of_other_names_give_the_same_scene(burst):
    quick = {"frames": burst.frames, "threads": 1, "solver": {"max_iterations": 5}}
    usual = deepir.run("nuc", **quick)
    named = deepir.run({"problem": "nuc", "prior": "foe", "physics": PHYSICS}, **quick)
    np.testing.assert_array_equal(named.scene, usual.scene)
