"""Standard streams that are closed, full, or lose their reader, and names that hold control characters."""

import os
import resource
import subprocess
import sys

import numpy as np
import pytest

from deepir.cli.terminal import standard_streams

NAMES = "a\x1b[31mb.npz", "a\nerror: b.npz", "a\u202eb.npz", "a\udcffb.npz"
DEEPIR = f'"{sys.executable}" -m deepir'


@pytest.mark.parametrize("line", ["| head -1", "2>&1 | head -1", ">&-", "2>&-", "<&- >&- 2>&-"])
def test_a_stream_that_is_closed_ends_nothing(tmp_path, line):
    command = f"{DEEPIR} --help {line}; echo ${{PIPESTATUS[0]}} > status"
    done = subprocess.run(["bash", "-c", command], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert "Traceback" not in done.stderr + done.stdout
    assert "Exception ignored" not in done.stderr
    assert (tmp_path / "status").read_text() == "0\n"


def test_work_goes_on_when_the_reader_of_stderr_has_gone(tmp_path):
    program = (
        "import sys, time; from deepir.cli.terminal import notify, standard_streams\n"
        "with standard_streams():\n"
        "    for _ in range(20000): notify('a line')\n"
        "    open('done', 'w').close()"
    )
    command = f'"{sys.executable}" -c "$0" 2>&1 | head -1; exit ${{PIPESTATUS[0]}}'
    done = subprocess.run(["bash", "-c", command, program], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "deepir: a line\n")
    assert (tmp_path / "done").exists()


def test_a_file_never_gets_the_number_of_a_closed_stream(tmp_path):
    program = (
        "from deepir.cli.terminal import standard_streams\n"
        "with standard_streams(), open('a', 'w') as file: assert file.fileno() > 2, file.fileno()"
    )
    command = f'"{sys.executable}" -c "$0" <&- >&- 2>&-'
    assert subprocess.run(["bash", "-c", command, program], cwd=tmp_path, check=False).returncode == 0


def test_standard_output_on_a_full_disk_is_status_2(tmp_path):
    with (tmp_path / "out").open("w") as out:
        done = subprocess.run(
            [sys.executable, "-m", "deepir", "--help"], stdout=out, stderr=subprocess.PIPE, text=True, check=False,
            env={name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"},
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100)),
        )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr == "deepir: error: standard output cannot be written: File too large\n"


def test_a_closed_standard_input_is_empty(monkeypatch):
    monkeypatch.setattr("sys.stdin", None)
    with standard_streams(), sys.stdin as stream:
        assert stream.buffer.read() == b""


def test_what_an_encoding_lacks_is_escaped(tmp_path, monkeypatch):
    with (tmp_path / "out").open("w", encoding="ascii") as out, monkeypatch.context() as patch:
        patch.setattr("sys.stdout", out)
        with standard_streams():
            print("σ 3")
    assert (tmp_path / "out").read_text() == "\\u03c3 3\n"


@pytest.mark.parametrize("name", NAMES)
def test_a_name_cannot_write_on_the_terminal(deepir, folder, burst, name):
    np.savez(name, frames=burst.frames)
    for command in (
        ("check", name),
        ("check", f"none{name}"),
        ("run", "nuc", f"data.path={name}", "method=average", "output.dir=o"),
        ("run", "nuc", f"data.path={name}", "output.dir=o"),
        ("simulate", name),
        ("calibrate", f"{name}.npz", name),
    ):
        _, out, err = deepir(*command)
        for line in (out + err).splitlines():
            assert line.isprintable()
            assert not line.startswith("error: b")
    if not (folder / "o").exists():  # refused
        assert "not UTF-8" in deepir("run", "nuc", f"data.path={name}")[2]
        return
    log = (folder / "o/deepir.log").read_text(encoding="utf-8")
    assert all(line.isprintable() for line in log.split("\n"))
    page = (folder / "o/report.html").read_text(encoding="utf-8")
    assert "\\u001b" not in page
    assert "\x1b" not in page
