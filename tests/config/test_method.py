"""The method of a configuration, and its options."""

from typing import Annotated

import pytest
from pydantic import Field

from deepir.config import dump, load, read
from deepir.errors import ConfigError
from deepir.pipeline.reconstruct import chosen
from deepir.registry import register


@pytest.fixture(autouse=True)
def mine(own_components):
    """A method with an option."""

    @register("method", "mine")
    def mine(burst, config, *, times: Annotated[int, Field(ge=1)] = 1):
        """Of one's own."""
        return burst, times


def test_a_name_is_a_method_without_options():
    name, run = chosen(load("nuc", ["method=mine"]))
    assert name == "mine"
    assert run("burst", "config", callbacks=(), checkpoint=None) == ("burst", 1)


@pytest.mark.parametrize("settings", [["method=mine", "method.times=3"], ["method={type: mine, times: 3}"]])
def test_options_are_those_of_its_signature(settings):
    assert chosen(load("nuc", settings))[1]("burst", "config") == ("burst", 3)


def test_options_are_written_and_read_back(tmp_path):
    (tmp_path / "config.yaml").write_text(dump(load("nuc", ["method=mine", "method.times=3"])))
    assert read(tmp_path / "config.yaml").method == {"type": "mine", "times": 3}


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (["method=mines"], "method: no method is called 'mines'; did you mean 'mine'"),
        (["method=mine", "method.tims=3"], "method 'mine': no option 'tims'; did you mean 'times'"),
        (["method=mine", "method.times=x"], "method 'mine': times = 'x': a whole number is needed"),
        (["method=mine", "method.times=0"], "times = 0: it must be greater than or equal to 1"),
        (["method=mine", "method.burst=x"], "method 'mine': no option 'burst'"),
        (["method.times=3"], "method 'joint': no option 'times'"),
    ],
)
def test_errors_name_the_method_and_what_is_allowed(settings, message):
    with pytest.raises(ConfigError, match=message):
        chosen(load("nuc", settings))
