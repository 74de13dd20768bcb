"""deepir is written for systems that are not at hand: the modules, calls and names that Windows lacks are not used."""

import ast
import concurrent.futures
import functools
import multiprocessing
import re
import subprocess
import sys

import pytest
from documentation import ROOT

import deepir
from deepir.storage.folder import RUN_FILES

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
from deepir.kernels.memory import peak_memory
assert peak_memory() is None
"""
#: What Windows lacks, or does otherwise: a file that exists is not renamed to, an open one is not removed.
POSIX_CALLS = {
    "os": "fork forkpty getuid geteuid getgid getpgid getpgrp killpg setsid chown lchown mkfifo nice uname statvfs "
    "sysconf sched_getaffinity wait wait4 getloadavg rename link chroot openpty ttyname register_at_fork",
    "signal": "SIGKILL SIGHUP SIGUSR1 SIGUSR2 SIGALRM SIGPIPE SIGCHLD SIGQUIT SIGSTOP SIGCONT pause alarm setitimer",
    "time": "tzset clock_gettime",
}
POSIX_OPTIONS = {"preexec_fn", "start_new_session", "pass_fds", "process_group"}
TEXT_MODE = re.compile(r"[rwxa+t]+")
SOURCES = {path.relative_to(ROOT).as_posix(): path for path in sorted((ROOT / "deepir").rglob("*.py"))}


@functools.cache
def nodes(path):
    """All nodes of a file, but for what is done only where `hasattr` finds it."""
    found = [ast.parse(path.read_text(encoding="utf-8"))]
    for node in found:
        if not (isinstance(node, ast.If) and "hasattr" in ast.unparse(node.test)):
            found.extend(ast.iter_child_nodes(node))
    return found


def posix_only(node):
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
        return node.attr in POSIX_CALLS.get(node.value.id, "").split()
    if isinstance(node, ast.Call):
        renamed = isinstance(node.func, ast.Attribute) and node.func.attr == "rename"
        return renamed or any(each.arg in POSIX_OPTIONS for each in node.keywords)
    return False


def text_of_any_encoding(node):
    """A file that is read or written as text, in whatever encoding the system likes."""
    if not isinstance(node, ast.Call) or any(each.arg == "encoding" for each in node.keywords):
        return False
    name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
    if name in ("read_text", "write_text"):
        return isinstance(node.func, ast.Attribute)
    if name in ("run", "Popen", "check_output"):
        return any(each.arg in ("text", "universal_newlines") for each in node.keywords)
    if name != "open":
        return False
    modes = node.args[:1] if isinstance(node.func, ast.Attribute) else node.args[1:2]  # path.open("w"), open(path, "w")
    return not modes or (isinstance(modes[0], ast.Constant) and bool(TEXT_MODE.fullmatch(str(modes[0].value))))


def test_all_modules_are_imported_without_those_of_posix():
    ended = subprocess.run([sys.executable, "-c", IMPORT_ALL], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr


@pytest.mark.parametrize("wrong", [posix_only, text_of_any_encoding])
def test_no_call_depends_on_the_system(wrong):
    found = [f"{name}:{node.lineno}" for name, path in SOURCES.items() for node in nodes(path) if wrong(node)]
    assert not found


@pytest.mark.parametrize(
    ("code", "wrong"),
    [
        ("os.fork()", posix_only),
        ("signal.signal(signal.SIGHUP, f)", posix_only),
        ("part.rename(path)", posix_only),
        ("Popen(c, start_new_session=True)", posix_only),
        ("path.read_text()", text_of_any_encoding),
        ("open(path, 'w')", text_of_any_encoding),
        ("path.open()", text_of_any_encoding),
        ("run(c, text=True)", text_of_any_encoding),
    ],
)
def test_what_depends_on_the_system_is_seen(tmp_path, code, wrong):
    (tmp_path / "code.py").write_text(code)
    assert any(map(wrong, nodes(tmp_path / "code.py")))


def test_no_process_is_forked():
    found = [name for name, path in SOURCES.items() if "multiprocessing" in path.read_text(encoding="utf-8")]
    assert not found  # processes are started anew, with arguments; those of `compare` are dask's
    dask = pytest.importorskip("dask")
    pytest.importorskip("distributed")
    assert dask.config.get("distributed.worker.multiprocessing-method") == "spawn"


def test_files_have_names_that_every_system_takes():
    from deepir.sweep.cells import folder_name

    hostile = folder_name({"data.path": "C:\\a|b", "prior": 'x?*"<y>', "seed": "1"})
    for name in (*RUN_FILES, hostile):
        assert not re.search(r'[<>:"/\\|?*\x00-\x1f]|[. ]$', name), name


@pytest.mark.slow
def test_a_run_works_in_a_process_that_is_spawned(burst):
    with concurrent.futures.ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        result = pool.submit(deepir.run, "nuc", frames=burst.frames, method="average").result()
    assert result.scene.shape == burst.frames.shape[1:]
