"""Components by their short names."""

import sys

import pytest

from deepir import registry
from deepir.errors import ConfigError
from deepir.registry import COMPONENT_MODULES, components, load_plugin, lookup, register, summary


@pytest.mark.parametrize("kind", COMPONENT_MODULES)
def test_every_component_says_in_a_line_what_it_is(kind):
    for name, component in components(kind).items():
        line = summary(component)
        assert line.endswith((".", ":")), (name, line)
        assert len(line) <= 120, (name, line)


def test_a_misspelt_name_gives_the_place_and_the_nearest():
    with pytest.raises(ConfigError, match=r"scene\.penalties: no penalty is called 'tvv'; did you mean 'tv'\?"):
        lookup("penalty", "tvv", "scene.penalties")
    with pytest.raises(ConfigError, match=r"no penalty is called 'zzz'; allowed: .*huber_tv, l1, red, ridge"):
        lookup("penalty", "zzz")


def test_a_name_is_taken_once_but_a_module_may_be_imported_again(own_components):
    def one():
        """One."""

    register("method", "again")(one)
    register("method", "again")(one)
    assert lookup("method", "again") is one
    assert summary(one) == "One."

    def other():
        """Other."""

    with pytest.raises(ValueError, match=r"method 'again' is taken by .*one"):
        register("method", "again")(other)
    with pytest.raises(ValueError, match="unknown kind of component 'penlty': did you mean 'penalty'"):
        register("penlty", "x")


@pytest.fixture
def outside(tmp_path, monkeypatch, own_components):
    """Writes the module of a package that is installed, with an entry point."""
    info = tmp_path / "outside-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: outside\nVersion: 1\n")
    (info / "entry_points.txt").write_text("[deepir.plugins]\nmine = outside\n")
    monkeypatch.syspath_prepend(tmp_path)
    registry._load_plugins.cache_clear()
    yield tmp_path.joinpath("outside.py").write_text
    registry._load_plugins.cache_clear()
    sys.modules.pop("outside", None)


METHOD = """
from deepir.registry import register

@register("method", "outside")
def outside():
    "Out."
"""


@pytest.mark.parametrize("by_name", [False, True], ids=["entry point", "module"])
def test_a_plugin_adds_its_components_by_its_entry_point_or_module(outside, by_name):
    outside(METHOD)
    if by_name:
        load_plugin("outside")
    assert summary(lookup("method", "outside")) == "Out."


def test_a_plugin_that_does_not_load_or_is_not_there_is_named(outside):
    with pytest.raises(ConfigError, match="plugin 'no_such_module' cannot be imported"):
        load_plugin("no_such_module")
    outside("raise RuntimeError('broken')")
    with pytest.raises(ConfigError, match=r"plugin 'mine' \(outside\) does not load: broken"):
        components("method")
