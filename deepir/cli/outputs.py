"""Output files of a command: checked, and written by one process at a time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def check_output_name(path: Path, suffix: str) -> None:
    """Check the name of an output file: its suffix, such as ".npz", and its folder.

    Raises:
        DataError: It has another suffix, or its folder is missing.
    """
    from deepir.errors import DataError

    if path.suffix != suffix or not path.parent.is_dir():
        raise DataError(f"{path}: give a file name that ends in {suffix}, in a folder that exists")


def config_stem(name: str) -> str:
    """Name of a configuration without folder and suffix, for the default output folder.

    Args:
        name: A shipped configuration, or a .yaml file.
    """
    return Path(name).stem if Path(name).is_file() else name


@contextmanager
def held_outputs(*paths: Path, overwrite: bool, source: str | Path | None = None) -> Iterator[None]:
    """A context in which no other process writes these files.

    Args:
        paths: The files.
        overwrite: They may be there.
        source: A file that must not be among them.

    Raises:
        DeepIRError: A file is there, or is the source; their folder is missing; another process writes them.
    """
    from deepir.errors import DataError
    from deepir.storage.lock import locked_files

    for path in paths:
        if not path.parent.is_dir():
            raise DataError(f"{path}: cannot be written: there is no folder {path.parent}")
    with locked_files(*paths):
        for path in paths:
            if path.exists() and source is not None and Path(source).exists() and path.samefile(source):
                raise DataError(f"{path} is the recording itself: give another --output")
            if path.exists() and not overwrite:
                raise DataError(f"{path} exists; replace it with --overwrite, or give another name")
        yield
