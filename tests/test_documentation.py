"""What documentation and docstrings show runs, what is listed is there, and links lead somewhere."""

import doctest
import functools
import importlib
import re
import typing
from dataclasses import fields as dataclass_fields

import numpy as np
import pytest
import yaml
from documentation import OFF_THE_SITE, PAGES, ROOT, blocks, rows, script
from pydantic import BaseModel
from small_problems import whole

from deepir.cli import app
from deepir.config import SHIPPED_CONFIGS, load
from deepir.config.schema import Config
from deepir.metrics import scores
from deepir.runner import check_components
from deepir.simulate import Settings

LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
PARTS = ROOT / "docs/tutorials/python.md"
CONFIGURATION = ROOT / "docs/reference/configuration.md"
#: Pages whose blocks have tests of their own.
APART = {ROOT / "docs/how-to/extending.md", ROOT / "docs/how-to/ablations.md"}


def ids(path):
    return str(path.relative_to(ROOT))


@functools.cache
def anchors(page):
    """What GitHub makes of the headings."""
    text = re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    titles = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", [*PAGES, *OFF_THE_SITE], ids=ids)
def test_links_resolve(page):
    for link in LINK.findall(page.read_text()):
        if link.startswith("https://"):
            continue
        name, _, anchor = link.partition("#")
        target = (page.parent / name) if name else page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


@pytest.mark.parametrize("page", PAGES, ids=ids)
def test_files_that_are_named_are_there(page):
    for path in re.findall(r"`((?:deepir|docs|configs|tests|benchmarks|notes)/[\w./-]+)`", page.read_text()):
        assert (ROOT / path).exists(), path


@pytest.mark.parametrize("page", [page for page in PAGES if page not in APART and blocks(page, "python")], ids=ids)
def test_python_blocks_run(page, burst, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.savez("burst.npz", frames=burst.frames)
    for _, text in blocks(page, "python"):
        namespace = {}
        exec(compile(text, str(page), "exec"), namespace)
        if page == PARTS and "Problem(" in text:  # composed by hand, it finds the scene
            scene = namespace["solution"].values["scene"][0, 0, 20:-20, 20:-20].numpy()
            found, raw = (scores(each, burst.truth.scene)["psnr_aligned"] for each in (scene, burst.frames[0]))
            assert found > raw + 10


@pytest.mark.parametrize("page", [page for page in PAGES if page not in APART and blocks(page, "yaml")], ids=ids)
def test_yaml_blocks_make_problems(page):
    shipped = yaml.safe_load((SHIPPED_CONFIGS / "nuc.yaml").read_text())
    burst = whole(np.random.default_rng(0).random((3, 24, 32)))
    for _, text in blocks(page, "yaml"):
        block = yaml.safe_load(text)
        if "sensor" in block:  # a part of `physics`
            block = {"physics": shipped["physics"] | block}
        check_components(load(shipped | block), burst)


def test_the_configuration_that_is_shown_is_the_one_that_is_shipped():
    shipped = yaml.safe_load((SHIPPED_CONFIGS / "nuc.yaml").read_text())
    for page in (PARTS, CONFIGURATION):
        assert yaml.safe_load(blocks(page, "yaml")[0][1]) == shipped


@pytest.mark.parametrize("page", [page for page in PAGES if page not in APART], ids=ids)
def test_settings_in_commands_are_taken(page):
    text = page.read_text()
    shown = re.findall(r"^(?:`)?deepir run nuc ([^#`\n]+)", text, re.MULTILINE)
    for settings in shown:
        load("nuc", [each for each in settings.split() if "=" in each])


def schema_keys(schema, prefix=""):
    """Every key of the schema with its default; ... where there is none."""
    found = {}
    for name, field in schema.model_fields.items():
        only_a_group = isinstance(field.default, BaseModel) or field.default_factory is not None
        if not only_a_group:
            found[prefix + name] = ... if field.is_required() else field.default
        again = prefix.startswith("datasets.")  # their data and noise have the keys of the first one's
        for model in [] if again else _models(field.annotation):
            found |= schema_keys(model, f"{prefix}{name}.")
    return found


def _models(annotation):
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for each in typing.get_args(annotation) for model in _models(each)]


def literal(cell):
    return yaml.safe_load(cell.strip("`")) if cell.startswith("`") else None


def test_every_key_is_documented_with_its_default():
    table = {key.strip("`"): default for key, default, _ in rows(CONFIGURATION, "## Keys")}
    known = schema_keys(Config)
    assert table.keys() == known.keys()
    for key, default in known.items():
        if default not in (None, ..., {}) and default != []:
            assert literal(table[key]) == default, key


def test_what_a_slot_may_hold_is_documented():
    from deepir.assembly import SLOT_KEYS

    assert {key.strip("`") for key, _ in rows(CONFIGURATION, "## Unknowns")} == set(SLOT_KEYS)


def test_every_setting_of_the_simulator_is_documented_with_its_default():
    table = {
        key.strip("`"): literal(default) for key, default, _ in rows(ROOT / "docs/reference/simulator.md", "## Bursts")
    }
    settings = {each.name: each.default for each in dataclass_fields(Settings)}
    assert table.keys() == settings.keys()
    for key, default in settings.items():
        assert table[key] == (list(default) if isinstance(default, tuple) else default), key


def test_every_command_is_documented():
    shown = {cell.split()[1] for cell, _ in rows(ROOT / "docs/reference/cli.md", "# Command line")}
    assert {name.strip("`") for name in shown} == {
        each.name or each.callback.__name__ for each in app.registered_commands
    }


def test_every_file_of_a_run_is_documented():
    from deepir.storage.folder import RUN_FILES

    text = (ROOT / "docs/reference/cli.md").read_text()
    assert [name for name in RUN_FILES if f"`{name}`" not in text] == ["checkpoint.part"]


@pytest.mark.parametrize("name", ["components", "messages"])
def test_a_page_that_is_written_from_the_code_is_current(name):
    written = getattr(script("generated"), f"{name}_page")()
    assert (ROOT / f"docs/reference/{name}.md").read_text() == written, "run: python docs/generated.py"


def test_the_citation_names_this_version_and_the_paper():
    import deepir

    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert cited["version"] == deepir.__version__
    assert f"## [{deepir.__version__}]" in (ROOT / "CHANGELOG.md").read_text()
    (paper,) = cited["references"]
    assert paper["title"] == "Thermal Image Processing via Physics-Inspired Deep Networks"
    assert paper["authors"][0]["family-names"] == "Saragadam"


def test_the_readme_begins_with_the_demo_and_the_tests_and_ci_runs_these():
    _, first = blocks(ROOT / "README.md")[0]
    assert [line.partition("#")[0].strip() for line in first.splitlines()] == ["make demo", "make test"]
    assert (ROOT / ".ci/run").read_text().splitlines()[-1] == "make test"


def test_the_picture_is_small():
    assert 20_000 < (ROOT / "docs/images/demo.png").stat().st_size < 300_000


def test_the_hooks_need_no_network():
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())
    assert [repo["repo"] for repo in hooks["repos"]] == ["local"]
    assert all(hook["language"] == "system" for repo in hooks["repos"] for hook in repo["hooks"])


MODULES = sorted(
    str(path.relative_to(ROOT).with_suffix("")).replace("/", ".")
    for path in (ROOT / "deepir").rglob("*.py")
    if ">>> " in path.read_text(encoding="utf-8")
)


@pytest.mark.parametrize("name", MODULES)
def test_the_examples_of_a_module_hold(name):
    result = doctest.testmod(importlib.import_module(name))
    assert result.attempted > 0
    assert result.failed == 0
