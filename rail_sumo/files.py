"""Output that is there whole or not at all, and never in place of something that was not to be replaced."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rail_sumo.errors import InputError

AnyPath = str | Path
"""What functions that users call take for a path."""


def is_taken(folder: Path) -> bool:
    """Return whether there is something where a folder is to be; an empty one is nothing."""
    return any(folder.iterdir()) if folder.is_dir() else folder.exists()


def check_folder(folder: AnyPath, *, overwrite: bool = False, instead: str = "") -> None:
    """Raise InputError if `whole_folder` would be refused: better before an hour of driving than after it.

    Args:
        folder: where it would write.
        overwrite: whether the folder may hold something.
        instead: what the user may do about an existing folder beside choosing another.
    """
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"output folder '{folder}' is a file; choose another")
    if is_taken(folder) and not overwrite:
        raise InputError(f"output folder '{folder}' exists; choose another{instead}")
    _check_writable(folder)


def check_file(file: AnyPath, *, overwrite: bool = False) -> None:
    """Raise InputError if a file exists and is not to be replaced, or nothing can be written beside it."""
    file = Path(file)
    if file.is_dir():
        raise InputError(f"output file '{file}' is a folder; name a file in it")
    if file.exists() and not overwrite:
        raise InputError(f"output file '{file}' exists; choose another, or replace it with --overwrite")
    _check_writable(file.parent)


@contextmanager
def whole_file(file: AnyPath) -> Iterator[Path]:
    """Give the name to write to; what is there at the end takes the file's place at once.

    Raises:
        InputError: it cannot be written, or the disk is full.
    """
    file = Path(file)
    partial = file.with_name(f".{file.name}.{os.getpid()}.partial")  # two processes may write the same
    with writing(file):
        file.parent.mkdir(parents=True, exist_ok=True)
        try:
            yield partial
            partial.replace(file)
        finally:
            partial.unlink(missing_ok=True)


@contextmanager
def whole_folder(folder: AnyPath, *, overwrite: bool = False) -> Iterator[Path]:
    """Give an empty folder on the same disk to write into; at the end it becomes `folder`.

    With `overwrite` the folder may hold something: then its files and folders are replaced, one by one, by those of the
    same names, and others are left alone.

    Raises:
        InputError: it exists and is not empty, cannot be written to, or the disk is full.
    """
    folder = Path(folder)
    check_folder(folder, overwrite=overwrite)
    with writing(folder):
        place = _nearest(folder)  # on the same disk, and what is above a new folder is made with it, or not at all
        with tempfile.TemporaryDirectory(dir=place, prefix=f".{folder.name}.") as scratch:
            partial = Path(scratch, "whole")
            partial.mkdir()
            yield partial
            if place == folder:
                for new in sorted(partial.iterdir()):
                    old = folder / new.name
                    if old.is_dir():
                        shutil.rmtree(old)
                    new.replace(old)
            else:
                folder.parent.mkdir(parents=True, exist_ok=True)
                partial.rename(folder)


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Tell the user in one line of a disk that is full or cannot be written to."""
    try:
        yield
    except OSError as error:
        raise InputError(f"cannot write '{path}': {error.strerror or error}") from None


def _nearest(folder: Path) -> Path:
    """Return the folder, or what is there of the folders above it."""
    return next(path for path in (folder, *folder.absolute().parents) if path.exists())


def _check_writable(folder: Path) -> None:
    nearest = _nearest(folder)
    if not nearest.is_dir() or not os.access(nearest, os.W_OK):
        raise InputError(f"cannot write to '{folder}': '{nearest}' is not a writable folder")
