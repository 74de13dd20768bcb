"""Whatever a configuration says: it is taken, or a `DeepIRError` in one line; never another exception, never a hang."""

import copy
import os
import time

import numpy as np
import pytest
import small_problems
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from deepir.config import SHIPPED_CONFIGS, load, prior_names, shipped_names
from deepir.config.components import options_schema
from deepir.errors import DeepIRError
from deepir.kernels.memory import peak_memory
from deepir.registry import components, lookup
from deepir.runner import check_components

LONGEST = 5.0  # seconds
MOST = 2**30  # bytes
NAMES = [name for name in shipped_names() if not name.startswith("paper/")]

damaged = settings(
    max_examples=int(os.environ.get("DEEPIR_FUZZ", "20")),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)

#: Each stands for nine of the one before, the last for 400 million.
BOMB = "a: &a [x, x]\n" + "".join(
    f"{new}: &{new} [{','.join([f'*{old}'] * 9)}]\n" for old, new in zip("abcdefgh", "bcdefghi", strict=True)
)
MERGED = BOMB.replace("[x, x]", "{x: 1}").replace(" [", " {<<: [").replace("]", "]}")
#: What nobody means, and what does harm where it is believed.
EVIL = [
    None, True, False, 0, 1, -1, 2, 3, 7, 2**31, 2**63, 2**70, -(2**70), 10**5, 10**12,
    0.0, -0.0, 0.5, 1e-320, 1e300, -1e300, float("nan"), float("inf"), float("-inf"),
    "", " ", "auto", "null", "none", ".", "..", "/", "~", "\0", "\ud800", "é\u202e", "x" * 5000,
    "tv", "pixels", "rigid", "gaussian", "column+row+pixel", "column+column", "+", "column+", "register", "average",
    "${data.path}", "${x}", "${", "${oc.env:HOME}", "${oc.env:NOPE}", "${scene}", "${oc.create:${scene}}", "???",
    "!!python/object/apply:os.system [ls]", "/dev/zero", "/proc/self/mem", "~nosuchuser/x.yaml", "x" * 300 + ".yaml",
    "nuc.yaml", "2:5", "1e999", "0x10",
    [], {}, [[]], [{}], {"": 1}, {"type": None}, {"type": "tv"}, {"type": "pixels"}, {"type": []}, {"type": {}},
    [1, 2], [0, 0, 0, 0], [1e300] * 4, {"tv": None}, {"tv": "auto"}, {"tv": {"weight": -1}}, {1: 2}, {None: None},
    {True: 1}, {"a": {"b": {"c": {}}}}, {"a.b": 1}, {"type": "constant", "path": "/dev/zero"},
]  # fmt: skip
values = st.one_of(
    st.sampled_from(EVIL),
    st.integers(),
    st.floats(),
    st.text(max_size=20),
    st.recursive(
        st.none() | st.booleans() | st.integers(-5, 5) | st.text(max_size=5),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
        max_leaves=8,
    ),
)


junk = st.binary(max_size=6) | st.sampled_from(
    [b"&a", b"*a", b"<<: ", b"- ", b"\t", b"? ", b"!!python/name:os.system ", b"---\n", b"{", b"${x}"]
)
signs = st.text(alphabet="{}[]&*!|>-:?,#'\"%@ \nabc01${}<", max_size=80).map(str.encode)


@pytest.fixture(scope="module")
def burst():
    """Two frames of noise."""
    return small_problems.whole(np.random.default_rng(0).random((2, 24, 32)))


@pytest.fixture(scope="module", autouse=True)
def modest():
    """Whatever a configuration asks for, checking it takes less than a gigabyte."""
    before = peak_memory()
    yield
    assert 2**20 * (peak_memory() - before) < MOST


def take_or_refuse(burst, *arguments):
    """Load, and check as before a run; an error is for the user."""
    begun, message = time.process_time(), ""  # however busy the machine is
    try:
        check_components(load(*arguments), burst)
    except DeepIRError as error:
        message = str(error)
    assert "Traceback" not in message
    assert time.process_time() - begun < LONGEST


def places(tree, path=()):
    """Paths to all that is in a tree."""
    for key, value in tree.items() if isinstance(tree, dict) else ():
        yield (*path, key)
        yield from places(value, (*path, key))


def whole(name, prior):
    """A shipped configuration, its scene spelt out."""
    tree = yaml.safe_load((SHIPPED_CONFIGS / f"{name}.yaml").read_text())
    preset = yaml.safe_load((SHIPPED_CONFIGS / f"prior/{prior}.yaml").read_text())
    defaults = {"noise": {"read": 1.0}, "solver": {"max_iterations": 1}, "fidelity": {"type": "gaussian"}}
    return defaults | preset | tree | {"prior": prior}


def put(tree, path, value, rename=None):
    """A copy with another value, or under another key."""
    tree = copy.deepcopy(tree)
    node = tree
    for key in path[:-1]:
        node = node[key]
    if rename is None:
        node[path[-1]] = value
    else:
        node[rename] = node.pop(path[-1])
    return tree


KEYS = sorted({".".join(map(str, path)) for name in NAMES for path in places(whole(name, "dip"))})


@damaged
@given(data=st.data(), name=st.sampled_from(NAMES), prior=st.sampled_from(prior_names()), value=values)
def test_a_value_that_is_another(burst, data, name, prior, value):
    tree = whole(name, prior)
    path = data.draw(st.sampled_from(list(places(tree))))
    take_or_refuse(burst, put(tree, path, value))


@damaged
@given(
    data=st.data(), name=st.sampled_from(NAMES), key=st.text(max_size=8) | st.integers() | st.sampled_from(EVIL[:30])
)
def test_a_key_that_is_another(burst, data, name, key):
    tree = whole(name, "tv")
    path = data.draw(st.sampled_from(list(places(tree))))
    take_or_refuse(burst, put(tree, path, None, rename=key))


@pytest.mark.parametrize("kind", ["field", "penalty", "fidelity", "operator", "method"])
@damaged
@given(data=st.data(), value=values)
def test_an_option_that_is_another(burst, data, kind, value):
    name = data.draw(st.sampled_from(list(components(kind))))
    options = ["init", "fixed", *options_schema(lookup(kind, name)).model_fields]
    given_so = {"type": name, data.draw(st.sampled_from(options)): value}
    tree = whole("nuc", "tv")
    slots = {
        "field": [("scene",), ("physics", "warp", "motion"), ("physics", "sensor", "gain")],
        "penalty": [("scene", "penalties", name)],
        "operator": [("physics", "new")],
        "fidelity": [("fidelity",)],
        "method": [("method",)],
    }[kind]
    if kind == "penalty":
        del given_so["type"]
    if kind == "operator":
        given_so["before"] = "sensor"
    take_or_refuse(burst, put(tree, data.draw(st.sampled_from(slots)), given_so))


@damaged
@given(
    name=st.sampled_from(NAMES),
    changes=st.lists(
        st.tuples(
            st.sampled_from(KEYS) | st.text(max_size=12),
            st.sampled_from(["=", "", "==", "=[", ".x=", ".0="]),
            st.text(max_size=12) | st.sampled_from([str(each) for each in EVIL]),
        ).map("".join),
        max_size=3,
    ),
)
def test_settings_on_the_command_line(burst, name, changes):
    take_or_refuse(burst, name, changes)


@damaged
@given(data=st.data(), name=st.sampled_from(NAMES), mark=junk)
def test_a_file_that_is_damaged(tmp_path, burst, data, name, mark):
    content = (SHIPPED_CONFIGS / f"{name}.yaml").read_bytes()
    first = data.draw(st.integers(0, len(content)))
    last = data.draw(st.integers(first, min(len(content), first + 20)))
    (tmp_path / "own.yaml").write_bytes(content[:first] + mark + content[last:])
    take_or_refuse(burst, tmp_path / "own.yaml")


@damaged
@given(content=st.binary(max_size=200) | signs)
def test_a_file_that_is_made_up(tmp_path, burst, content):
    (tmp_path / "own.yaml").write_bytes(content)
    take_or_refuse(burst, tmp_path / "own.yaml")


@pytest.mark.parametrize(
    "text",
    [
        BOMB,
        "[" * 10_000,
        "{a: " * 3_000,
        "- " * 5_000 + "1",
        "physics: " + "[" * 500 + "]" * 500,
        "physics: " + "{a: " * 500 + "1" + "}" * 500,
        "physics: &x {a: *x}",
        "&x [*x]",
        "physics: {warp: {<<: &x {<<: *x}}}",
        "!!python/object/apply:os.system ['false']",
        "physics: !!python/name:os.system ",
        "physics: !!binary //8=",
        "physics: !!timestamp 2020-01-01",
        "physics: !!set {warp, sensor}",
        "physics: {warp: ${physics}}",
        "physics: {warp: ${physics.sensor}, sensor: ${physics.warp}}",
        "x: " + "9" * 100_000,
        MERGED,
        "physics: {warp: " + "{a: " * 20 + "1" + "}" * 21,
        "? [1, 2]\n: 3",
        "a: 1\n---\nb: 2",
        "\ufeffproblem: nuc",
        "x" * 1_000_000,
        "# only a comment",
    ],
    ids=map(str, range(24)),
)
def test_bombs(tmp_path, burst, text):
    (tmp_path / "own.yaml").write_text(text)
    take_or_refuse(burst, tmp_path / "own.yaml")
