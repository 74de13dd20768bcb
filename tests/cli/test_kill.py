"""SIGKILL at random moments, then `deepir resume`: the same scene each time."""

import json
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.parametrize("count", [1, pytest.param(20, marks=[pytest.mark.slow, pytest.mark.timeout(600)])])
def test_kill_and_resume(folder, count):
    command = [sys.executable, str(Path(__file__).with_name("kills.py")), "0", str(count)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    kills = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(kills) == count, done.stderr
    for each in kills:
        assert each["status"] == 0, each
        assert each["difference"] < 1e-4, each
