"""Two runs in one folder at the same moment: one is finished, the other refused."""

import json
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.parametrize("count", [1, pytest.param(100, marks=[pytest.mark.slow, pytest.mark.timeout(600)])])
def test_of_two_runs_in_one_folder_one_is_refused(folder, count):
    command = [sys.executable, str(Path(__file__).with_name("races.py")), str(count)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    races = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(races) == count, done.stderr
    for each in races:
        assert each == {"statuses": [0, 2], "whole": True, "named": True}
