"""Two runs start in one folder at the same moment: `python races.py COUNT`, in a folder with burst.npz.

Prints one line of JSON for each race. The processes are forked from this one, so that torch is imported once.
"""

import json
import os
import shutil
import sys
import time
from pathlib import Path

import numpy as np

from deepir import registry
from deepir.cli import main
from deepir.config import read
from deepir.storage import stored  # noqa: F401

RUN = ["run", "nuc", "data.path=burst.npz", "threads=1", "solver.max_iterations=1"]


def fork(*arguments, start=0.0, err=os.devnull):
    """Begin at the time `start`."""
    process = os.fork()
    if process == 0:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        os.dup2(os.open(err, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 2)
        time.sleep(max(0.0, start - time.time()))
        os._exit(main(arguments))
    return process


def status(process):
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])


def scene(folder):
    return np.load(f"{folder}/result.npz")["scene"]


def race():
    """Statuses; whether configuration and scene are the winner's; whether the loser names it."""
    start = time.time() + 0.02
    started = [
        fork(*RUN, f"seed={seed}", "output.dir=raced", start=start, err=f"err{seed}") for seed in (0, 1)
    ]
    statuses = [status(each) for each in started]
    first = statuses.index(0)
    whole = read(Path("raced/config.yaml")).seed == first and np.array_equal(
        scene("raced"), scene(f"alone{first}")
    )
    named = f"(process {started[first]} on " in Path(f"err{1 - first}").read_text()
    shutil.rmtree("raced")
    return {"statuses": sorted(statuses), "whole": whole, "named": named}


for kind in registry.COMPONENT_MODULES:
    registry.components(kind)
for seed in (0, 1):
    status(fork(*RUN, f"seed={seed}", f"output.dir=alone{seed}"))
for _ in range(int(sys.argv[1])):
    print(json.dumps(race()), flush=True)
