"""Writing files so that an existing one is never half overwritten: write beside, then rename."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from calib.errors import InputError


def write_file(path: Path | str, content: bytes | str) -> None:
    """Write a whole file, or leave what was there untouched.

    Raises:
        InputError: The folder does not exist or cannot be written to.
    """
    path = Path(path)
    data = content.encode("utf-8") if isinstance(content, str) else content
    with _explained(path):
        if path.is_dir():
            raise IsADirectoryError(21, "is a folder")
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(handle, "wb") as stream:
                stream.write(data)
            Path(temporary).chmod(0o666 & ~_umask())
            Path(temporary).replace(path)
        except BaseException:
            Path(temporary).unlink(missing_ok=True)
            raise


def check_folder(path: Path | str) -> None:
    """Raise `InputError` now if a result could not be written to the folder `path` later."""
    path = Path(path)
    with _explained(path):
        if path.exists() and not path.is_dir():
            raise NotADirectoryError(20, "is a file, not a folder")
        parent = path.resolve().parent
        while not parent.exists():
            parent = parent.parent
        for folder in (parent, path) if path.exists() else (parent,):
            with tempfile.TemporaryFile(dir=folder):
                pass


def check_file(path: Path | str) -> None:
    """Raise `InputError` now if the file `path` could not be written later."""
    path = Path(path)
    with _explained(path):
        if path.is_dir():
            raise IsADirectoryError(21, "is a folder")
        with tempfile.TemporaryFile(dir=path.resolve().parent):
            pass


def write_folder(path: Path | str, files: Mapping[str, bytes]) -> None:
    """Write a folder of files in one go; files of other names that were in it stay.

    The new folder is completed beside the old one and takes its place by renaming.

    Raises:
        InputError: The folder cannot be written.
    """
    path = Path(path).resolve()
    with _explained(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        staging = Path(tempfile.mkdtemp(dir=path.parent, prefix=f".{path.name}."))
        try:
            staging.chmod(0o777 & ~_umask())
            for name, content in files.items():
                (staging / name).write_bytes(content)
            if not path.exists():
                staging.rename(path)
                return
            for other in path.iterdir():
                if other.name not in files:
                    _copy(other, staging / other.name)
            old = Path(tempfile.mkdtemp(dir=path.parent, prefix=f".{path.name}.old."))
            path.rename(old / path.name)
            staging.rename(path)
            shutil.rmtree(old)
        except BaseException:
            shutil.rmtree(staging, ignore_errors=True)
            raise


def _copy(source: Path, destination: Path) -> None:
    if source.is_dir() and not source.is_symlink():
        shutil.copytree(source, destination, symlinks=True)
    else:
        shutil.copy2(source, destination, follow_symlinks=False)


def _umask() -> int:
    current = os.umask(0)
    os.umask(current)
    return current


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise InputError(f"{path}: cannot be written ({reason}); choose another place for the output") from None
