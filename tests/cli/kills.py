"""Kill runs at random moments and resume them: `python kills.py SEED COUNT`, in a folder with burst.npz.

Prints one line of JSON for each kill. The processes are forked from this one, so that torch is imported once.
"""

import json
import os
import random
import signal
import sys
import time
from pathlib import Path

import numpy as np

from deepir import registry
from deepir.cli import main
from deepir.optim import solve
from deepir.storage import stored  # noqa: F401

RUN = ["run", "nuc", "data.path=burst.npz", "threads=1", "solver.max_iterations=15"]
solve.solve.__kwdefaults__["every"] = 0.02  # seconds between checkpoints: a short run has some


def fork(*arguments):
    process = os.fork()
    if process == 0:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        os._exit(main(arguments))
    return process


def status(process):
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])


def kill(folder, delay):
    """Start a run and kill it after `delay` seconds; what it left, and what it took to finish it."""
    process = fork(*RUN, f"output.dir={folder}")
    time.sleep(delay)
    os.kill(process, signal.SIGKILL)
    os.waitpid(process, 0)
    left = sorted(path.name for path in folder.iterdir()) if folder.exists() else []
    again = ["resume", str(folder)] if "config.yaml" in left else [*RUN, f"output.dir={folder}"]
    return {"delay": delay, "left": left, "status": status(fork(*again))}


seed, count = map(int, sys.argv[1:])
rng = random.Random(seed)
for kind in registry.COMPONENT_MODULES:
    registry.components(kind)
start = time.monotonic()
status(fork(*RUN, "output.dir=alone"))
whole = time.monotonic() - start
scene = np.load("alone/result.npz")["scene"]
for i in range(count):
    found = kill(Path(f"killed{i}"), rng.uniform(0, whole))
    other = np.load(f"killed{i}/result.npz")["scene"]
    found["difference"] = float(np.abs(other - scene).max() / np.ptp(scene))
    print(json.dumps(found), flush=True)
