"""Kernels are compiled by processes beside a run, which then takes them from the cache."""

import importlib
import json
import os
import subprocess
import sys

import numpy as np
import pytest
from numba.core.sigutils import normalize_signature

from deepir.kernels import ahead

LISTS = [each.splitlines() for each in ahead.SIGNATURES.read_text(encoding="utf-8").split("\n\n")]
COUNT_COMPILED = """
import json, sys
from numba.core import event
from deepir.cli import main
with event.install_recorder("numba:compile") as compiled:
    status = main(sys.argv[1:])
print(json.dumps([status, [each[1].data["dispatcher"].py_func.__name__ for each in compiled.buffer]]))
"""


@pytest.mark.parametrize("line", [line for each in LISTS for line in each])
def test_a_line_of_the_lists_is_a_kernel_with_types(line):
    name = ahead._name(line)
    module, function = name.split(".")
    kernel = getattr(importlib.import_module(f"deepir.kernels.{module}"), function)
    types, _ = normalize_signature(line.removeprefix(name))
    assert len(types) == kernel.py_func.__code__.co_argcount


@pytest.mark.parametrize("lines", LISTS)
@pytest.mark.parametrize("count", [2, 6])
def test_the_kernels_of_a_module_are_compiled_by_one_process_in_order(lines, count):
    shares = ahead._shares(lines, count)
    assert sorted(line for share in shares for line in share) == sorted(lines)
    modules = [{line.split(".")[0] for line in share} for share in shares]
    assert sum(map(len, modules)) == len(set.union(*modules))
    assert all([lines.index(line) for line in share] == sorted(map(lines.index, share)) for share in shares)


def test_a_kernel_outside_the_lists_is_not_waited_for():
    assert not ahead.wait_for("raster.draw")


def test_where_no_process_can_be_started_kernels_are_compiled_here(monkeypatch):
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    done = {ahead._name(line): ahead.threading.Event() for line in LISTS[1]}
    ahead._compile_beside(LISTS[1], done)
    assert all(each.is_set() for each in done.values())


@pytest.mark.slow
def test_a_run_on_a_new_machine_compiles_nothing_itself_and_gives_the_same_bits(tmp_path):
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    scene = ["data.simulate.shape=[64,80]", "data.simulate.n_frames=4"]
    for name in ("new", "again"):
        command = [sys.executable, "-c", COUNT_COMPILED, "run", "nuc", *scene, f"output.dir={tmp_path / name}"]
        ended = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        assert json.loads(ended.stdout.splitlines()[-1]) == [0, []], ended.stdout
    with np.load(tmp_path / "new" / "result.npz") as new, np.load(tmp_path / "again" / "result.npz") as again:
        for each in new:
            np.testing.assert_array_equal(new[each], again[each])
