"""The recipe of a configuration: its problem's, with the effects that `effects` switches."""

from __future__ import annotations

from deepir.config import Config
from deepir.config.components import make
from deepir.problems.recipe import Recipe
from deepir.registry import lookup


def make_recipe(config: Config) -> Recipe:
    """The recipe of `config.problem`.

    `effects.NAME` is false (left out), true, or a mapping of the effect's options. An effect that the problem does not
    list itself, of a plugin say, comes last.

    Raises:
        ConfigError: There is no such problem or effect, or the effect has no such option.
    """
    kind: type[Recipe] = lookup("problem", config.problem, "problem")
    switches = dict.fromkeys(kind.effect_names, True) | config.effects
    effects = []
    for name, switch in switches.items():
        lookup("effect", name, f"effects.{name}")
        if switch is not False:
            options = {} if switch is True or switch is None else switch
            effects.append(make("effect", name, options, f"effects.{name}"))
    return kind(effects)
