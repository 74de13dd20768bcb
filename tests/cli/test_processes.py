"""Runs that are killed, race for a folder, or find a damaged state: what `make reliability` counts, a few times."""

import subprocess
import sys

import pytest
from documentation import ROOT


@pytest.mark.parametrize("count", [1, pytest.param(20, marks=[pytest.mark.slow, pytest.mark.timeout(600)])])
def test_a_result_is_whole_and_that_of_a_run_left_alone(count):
    code = (
        "from reliability_runs import count_runs\n"
        "for part in ('kills', 'races', 'flipped bits'):\n"
        f"    print(part, count_runs(part, 0, {count})['failed'])"
    )
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=ROOT / "benchmarks", capture_output=True, text=True, check=False)
    assert done.stdout == "kills 0\nraces 0\nflipped bits 0\n", done.stderr
