"""Recordings corrected into files: one, or an archive by many processes and machines, whatever interrupts them."""

from __future__ import annotations

import functools
import itertools
import json
import time
import traceback
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import deepir
from deepir.cli.arguments import RECORDING_SETTINGS, held_outputs, recording_config, recording_radiometry
from deepir.cli.terminal import Interrupted, Interruptible, echo, notify
from deepir.config import Config
from deepir.correct_recording import sensor_of_burst
from deepir.errors import ConfigError, DataError, DeepIRError
from deepir.io import atomic_files, readers, stream_data
from deepir.io.frames import digest
from deepir.io.output import open_writer, output_type, write_frames, write_text
from deepir.io.radiometry import unit_metadata
from deepir.kernels.memory import peak_memory
from deepir.messages import labelled
from deepir.recording.correct import CorrectedRecording, findings_lines
from deepir.report.panels import write_correction
from deepir.report.progress import track
from deepir.report.recording import write_recording_report

LISTS = (".txt", ".lst", ".csv")  # endings of a file that names recordings, one a line
CORRECTED, REFUSED, FAILED = "corrected", "refused", "failed"
EXIT = {CORRECTED: 0, REFUSED: 2, FAILED: 1}  # exit statuses, the gravest last


def correct_file(
    config: Config, target: Path, maps: Path, picture: Path, page: Path, *, rounded: bool, quiet: bool = False
) -> CorrectedRecording:
    """Estimate the sensor, then write maps, picture, report and all corrected frames.

    Args:
        config: Of how the recording is read and displayed.
        target: The corrected recording to write.
        maps: The file for the maps.
        picture: The file for the picture.
        page: The file for the report.
        rounded: Whether values are rounded to the recording's type.
        quiet: Whether nothing is printed.

    Returns:
        The corrected recording.
    """
    data, shown = config.data, config.output
    begun = time.perf_counter()
    read = functools.partial(stream_data, data)
    dtype = output_type(next(read()).dtype, rounded=rounded)
    metadata = unit_metadata(recording_radiometry(config))
    writer = open_writer(target, dtype, metadata, shown.palette, shown.tones)
    follow: Any = (lambda frames, *_: frames) if quiet else track
    corrected = CorrectedRecording.of(read, lambda frames: follow(frames, "reading"), sensor_of_burst)
    with atomic_files(maps, picture, page) as (own_maps, own_picture, own_page):
        corrected.save_maps(own_maps)
        if not quiet:
            _describe(corrected)
        try:
            with ThreadPoolExecutor(1) as beside, writer as write:
                drawn = beside.submit(write_correction, own_picture, corrected)
                count = write_frames(follow(iter(corrected), "correcting", len(corrected)), write)
                drawn.result()
                findings = list(findings_lines(corrected.estimate))
                unit = str(metadata.get("unit", "counts" if dtype.kind in "iu" else ""))
                write_recording_report(own_page, corrected, str(data.path), unit, findings)
        except Interrupted:
            if not maps.exists():
                own_maps.replace(maps)  # all that the rest needs
            raise
    if quiet:
        return corrected
    for line in findings:
        echo(line)
    speed = count / (time.perf_counter() - begun)
    echo(f"{target}: {count} frame(s), corrected at {speed:.0f} frames/s; maps: {maps}; to look at: {page}, {picture}")
    return corrected


def _describe(corrected: CorrectedRecording) -> None:
    """Print what is corrected, and warnings."""
    segments = corrected.segments
    if len(segments) > 1:
        echo(f"the fixed pattern jumps {len(segments) - 1} time(s), as after a closure of the shutter:")
        for each in segments:
            echo(f"  {each.description}")
    known, bad = len(corrected.keyframes.frames), int(corrected.estimate.bad_pixels.sum())
    pixels = f"{bad} bad pixel{'s' * (bad != 1)}"
    echo(f"correction: {corrected.estimate.kept}, from {known} of {len(corrected)} frames; {pixels}")
    for line in labelled(corrected.messages):
        notify(line)


@dataclass(frozen=True)
class Task:
    """A recording, and the name of its results below the folder of all: its own path below the archive."""

    file: Path
    name: str

    def outputs(self, folder: Path) -> tuple[Path, Path, Path, Path]:
        """The corrected recording, its maps, its picture and its report."""
        ends = ("_corrected.tif", "_maps.npz", ".png", ".html")
        corrected, maps, picture, page = (folder / f"{self.name}{end}" for end in ends)
        return corrected, maps, picture, page

    def record(self, folder: Path) -> Path:
        """The file that says how it went: one line of JSON."""
        return folder / f"{self.name}.json"


def correct_all(
    source: str, settings: Sequence[str], folder: Path, shard: str, *, rounded: bool, overwrite: bool
) -> int:
    """Correct the recordings of one shard that are not corrected yet; a JSON line each.

    Args:
        source: A folder of recordings, or a file that lists them.
        settings: `KEY=VALUE` of how they are read and displayed.
        folder: For the results, and a record of each.
        shard: `i/n`: every n-th recording, from the i-th on.
        rounded: Whether values are rounded to the recordings' types.
        overwrite: Whether what is done is done again.

    Returns:
        The exit status: 0, 1 if a recording failed, else 2 if one was refused.

    Raises:
        DataError: There are no recordings.
        ConfigError: A setting or the shard is wrong.
    """
    recording_config(source, settings, RECORDING_SETTINGS)  # what is wrong for one is wrong for all
    first, _, count = shard.partition("/")
    if not (first.isdecimal() and count.isdecimal() and 1 <= int(first) <= int(count)):
        raise ConfigError(f"--shard {shard}: give I/N, the I-th of N parts, such as 1/4")
    found = recordings_of(source, any_file=any(each.startswith("data.raw") for each in settings))
    tasks = found[int(first) - 1 :: int(count)]
    done, states = 0, [CORRECTED]
    made_by = {"version": deepir.__version__, "settings": sorted(settings), "rounded": rounded}
    with Interruptible():
        for task in tasks:
            this = made_by | {"sha256": _digest(task.file)}
            status = "" if overwrite else _done(task, folder, this)
            done += bool(status)
            states.append(status or _corrected(task, folder, settings, this, rounded=rounded))
    notify(f"{len(tasks)} recording(s), {done} of them done already; results: {folder}")
    return EXIT[max(states, key=list(EXIT).index)]


def recordings_of(source: str, *, any_file: bool = False) -> list[Task]:
    """The recordings that a folder holds, at any depth, or that a file lists, in the order of their names.

    Args:
        source: The folder or the list.
        any_file: Whether files of any ending are taken, as those without a header are.

    Raises:
        DataError: There is none, or a listed one is given twice.
    """
    path = Path(source)
    if path.is_dir():
        inside = sorted(each for each in path.rglob("*") if each.is_file() and not each.name.startswith("."))
        wanted = [each for each in inside if any_file or each.suffix.lower() in readers.suffixes()]
        tasks = [Task(each, str(each.relative_to(path))) for each in wanted]
    elif path.is_file() and path.suffix.lower() in LISTS:
        lines = [line.strip() for line in path.read_text(encoding="utf-8").splitlines()]
        files = [path.parent / line for line in lines if line and not line.startswith("#")]
        tasks = [Task(each, str(each.relative_to(each.anchor or "."))) for each in sorted(files)]
    else:
        raise DataError(f"{source}: give a folder of recordings, or a file ({', '.join(LISTS)}) with one a line")
    if not tasks:
        raise DataError(f"{source}: no recordings in it")
    if twice := next((a.name for a, b in itertools.pairwise(tasks) if a.name == b.name), None):
        raise DataError(f"{source}: {twice} is listed twice")
    return tasks


def _corrected(task: Task, folder: Path, settings: Sequence[str], made_by: dict[str, Any], *, rounded: bool) -> str:
    """Correct a recording, write its record and print it; its status."""
    begun, outputs = time.perf_counter(), task.outputs(folder)
    outputs[0].parent.mkdir(parents=True, exist_ok=True)
    found: dict[str, Any] = {"file": str(task.file), "status": CORRECTED}
    try:
        config = recording_config(str(task.file), settings, RECORDING_SETTINGS)
        with held_outputs(*outputs, overwrite=True, source=task.file):
            found |= made_by
            corrected = correct_file(config, *outputs, rounded=rounded, quiet=True)
        estimate = corrected.estimate
        found |= {
            "frames": len(corrected),
            "correction": str(estimate.kept),
            "bad_pixels": int(estimate.bad_pixels.sum()),
            "messages": list(map(str, corrected.messages)),
        }
    except DeepIRError as error:
        status = FAILED if isinstance(error.__context__, ImportError) else REFUSED  # a package may come
        found |= {"status": status, "messages": [str(error)]}
    except Exception as error:  # the others go on; nobody may sit beside the archive
        last = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(last.filename).name}:{last.lineno}"
        found |= {"status": FAILED, "messages": [f"{type(error).__name__}: {error} ({where})"]}
    found |= {"seconds": round(time.perf_counter() - begun, 2), "peak_memory_mb": peak_memory()}
    line = json.dumps(found)
    write_text(task.record(folder), line + "\n")
    echo(line)
    return str(found["status"])


def _done(task: Task, folder: Path, made_by: dict[str, Any]) -> str:
    """The status of a recording that was corrected or refused with this file, settings and version; "" of others."""
    try:
        found = json.loads(task.record(folder).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return ""
    status = found.get("status") if isinstance(found, dict) and made_by.items() <= found.items() else None
    is_done = status == REFUSED or (status == CORRECTED and all(map(Path.exists, task.outputs(folder))))
    return str(status) if is_done else ""


def _digest(file: Path) -> str:
    """Digest of a file; empty if it cannot be read."""
    try:
        return digest(file)
    except (OSError, DeepIRError):
        return ""
