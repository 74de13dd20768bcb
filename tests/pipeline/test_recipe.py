"""Effects are switched by name."""

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


def test_a_problem_has_the_effects_that_it_lists_in_their_order():
    recipe = make_recipe(load("nuc"))
    assert names(recipe) == list(type(recipe).effect_names)


def test_an_effect_is_left_out_and_the_others_stay():
    recipe = make_recipe(load("nuc", ["effects.vignetting=false"]))
    assert names(recipe) == [name for name in type(recipe).effect_names if name != "vignetting"]


def test_an_option_of_an_effect_is_set_by_name():
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


def test_an_effect_that_the_problem_does_not_list_comes_last():
    recipe = make_recipe(load("sr", ["effects.unobserved=true"]))
    assert names(recipe)[-1] == "unobserved"


@pytest.mark.parametrize("kind", EFFECTS.values(), ids=EFFECTS)
def test_every_effect_has_defaults_and_documented_options(kind):
    effect = kind()
    assert isinstance(effect, Effect)
    assert all(f"{option}:" in kind.__doc__ for option in effect.__dataclass_fields__)


def test_every_effect_of_nuc_can_be_left_out():
    """One burst without any of them: a plain problem is left, which still runs."""
    sim = simulate(settings=Settings(shape=(40, 48), n_frames=4), seed=3)
    off = [f"effects.{name}=false" for name in type(make_recipe(load("nuc"))).effect_names]
    result = deepir.run("nuc", *off, "prior=tv", "solver.max_iterations=3", frames=sim.frames)
    assert np.isfinite(result.scene).all()


def test_without_its_effect_a_moving_object_spoils_the_scene():
    sim = simulate(settings=Settings(shape=(96, 112), walker=0.4, n_frames=6), seed=8)
    with_it, without = (
        deepir.run("nuc", f"effects.moving_objects={switch}", "prior=tv", frames=sim.frames)
        for switch in ("true", "false")
    )
    assert "moving" in with_it.extra
    assert "moving" not in without.extra
