"""The package is imported where modules of POSIX are missing, as on Windows."""

import subprocess
import sys

MISSING = ("fcntl", "resource", "pwd", "grp", "termios", "tty", "pty", "syslog")
IMPORT_ALL = f"""
import importlib, pkgutil, sys
import numpy, torch, distributed  # they find their own ways on each system
for name in {MISSING}:
    sys.modules[name] = None
import deepir
for module in pkgutil.walk_packages(deepir.__path__, "deepir."):
    if not module.name.endswith("__main__"):
        importlib.import_module(module.name)
from deepir.runner import peak_memory
assert peak_memory() is None
"""


def test_all_modules_are_imported_without_those_of_posix():
    ended = subprocess.run([sys.executable, "-c", IMPORT_ALL], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
