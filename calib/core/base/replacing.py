"""Files and folders that are completed in a folder beside their place, and then take it in one step.

A program can be ended at any moment, and two can write to one place. So a file or folder is only ever replaced as a
whole: by renaming where nothing is there, and otherwise by exchanging the two names, which Linux does in one step
(renameat2 with RENAME_EXCHANGE). Before that, files of others in the old folder are linked into the new one.

Where a system or a file system has no such exchange, the old folder is set aside and the new one takes its place: a
program that is killed between these two steps leaves the old one, whole, in a folder `.calib-old-*`, and the next
program that writes there puts it back.

A program locks the folder in which it completes something; the lock ends with the program, however it ends. A folder
without a lock is a leftover of a killed program, and the next program that writes there removes it. While a folder is
replaced, the folder above it is locked, so that no other program misses a folder that was set aside. File systems
without locks keep their leftovers, and only the exchange is safe for two programs at once there.
"""

from __future__ import annotations

import ctypes
import errno
import fcntl
import os
import shutil
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_NEW, _OLD = ".calib-new-", ".calib-old-"
_AT_FDCWD, _RENAME_EXCHANGE = -100, 2  # of linux/fcntl.h and linux/fs.h
_NO_EXCHANGE = (errno.ENOSYS, errno.EINVAL, errno.EOPNOTSUPP, errno.EPERM)
_OCCUPIED = (errno.ENOTEMPTY, errno.EEXIST)


@contextmanager
def new_folder(parent: Path, prefix: str = _NEW) -> Iterator[Path]:
    """Yield an empty folder in `parent`; what has its name after the block is removed."""
    while True:
        path = Path(tempfile.mkdtemp(dir=parent, prefix=prefix))
        try:
            path.chmod(0o700)  # whatever the umask is
            handle = os.open(path, os.O_RDONLY)
        except FileNotFoundError:  # another program took it for a leftover
            continue
        if _try_lock(path, handle):
            break
        os.close(handle)
    try:
        yield path
    finally:
        _discard(path)
        os.close(handle)


def _try_lock(path: Path, handle: int) -> bool:
    """Lock a new folder; False if another program took it for a leftover just before."""
    with suppress(OSError):  # without locks nothing is ever taken for a leftover
        fcntl.flock(handle, fcntl.LOCK_EX)
    try:
        return os.path.samestat(path.stat(), os.fstat(handle))
    except FileNotFoundError:
        return False


def clear_leftovers(parent: Path) -> None:
    """Remove what killed programs left in a folder, and put back what one had set aside."""
    with suppress(OSError):
        for path in [Path(entry) for entry in os.scandir(parent) if entry.name.startswith((_NEW, _OLD))]:
            with suppress(OSError):  # somebody else's, or gone
                handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
                try:
                    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)  # an error while its program lives
                    _discard(path)
                finally:
                    os.close(handle)


def _discard(path: Path) -> None:
    """Remove a folder, or a file of earlier versions; what was set aside in it goes back if its place is free."""
    if not path.is_dir():
        path.unlink(missing_ok=True)
        return
    if path.name.startswith(_OLD):
        for old in list(path.iterdir()):
            if not (path.parent / old.name).exists():
                old.rename(path.parent / old.name)
    for folder, names, _ in os.walk(path):  # folders that may only be read can be removed after this
        for inner in (Path(folder, name) for name in names):
            if not inner.is_symlink():
                with suppress(OSError):
                    inner.chmod(0o700)
    shutil.rmtree(path, ignore_errors=True)


def replace_folder(new: Path, path: Path, obsolete: Collection[str]) -> None:
    """Let a new folder beside `path` take its place; other entries of `path` stay, but for `obsolete` names.

    The new folder is without what others keep in `path`; what has its name afterwards may be removed.
    """
    with _exclusive_in(path.parent):
        while True:
            leave = {*os.listdir(new), *obsolete}  # noqa: PTH208  # names alone
            carried = _carry(path, new, leave)
            try:
                new.rename(path)  # nothing there, or an empty folder
                return
            except OSError as problem:
                if problem.errno not in _OCCUPIED:
                    raise
            try:
                if exchange(new, path):
                    _follow(new, path, carried, leave)
                    return
                if _try_replace_folder(new, path):
                    return
            except FileNotFoundError:
                if not new.exists():
                    raise
                # another program has just moved the folder: try again


@contextmanager
def _exclusive_in(parent: Path) -> Iterator[None]:
    """Lock a folder, if the file system has locks, so that only one program at a time replaces entries in it."""
    handle = os.open(parent, os.O_RDONLY)
    try:
        with suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        with suppress(OSError):  # a forked process may hold a copy of the handle, which closing would not unlock
            fcntl.flock(handle, fcntl.LOCK_UN)
        os.close(handle)


def exchange(path: Path, other: Path) -> bool:
    """Exchange two names in one step; False where the system or the file system cannot.

    `OSError` if the system can exchange names, but one of these may not be moved.
    """
    function = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if function is None:
        return False
    if function(_AT_FDCWD, os.fsencode(path), _AT_FDCWD, os.fsencode(other), _RENAME_EXCHANGE) == 0:
        return True
    number = ctypes.get_errno()
    if number in _NO_EXCHANGE:
        return False
    raise OSError(number, os.strerror(number))


def _try_replace_folder(new: Path, path: Path) -> bool:
    """Replace a folder in two steps; False if another program was faster, and it has to be tried again."""
    with new_folder(path.parent, _OLD) as attic:  # the end of the block puts the old folder back if its place is free
        path.rename(attic / path.name)
        try:
            new.rename(path)
        except OSError as problem:
            if problem.errno in _OCCUPIED:
                return False
            raise
    return True


def _carry(old: Path, new: Path, leave: Collection[str]) -> tuple[os.stat_result, set[str]] | None:
    """Link the other files of a folder into the new one; return the old folder's status, and the names seen in it."""
    try:
        was, entries = old.stat(), list(old.iterdir())
    except FileNotFoundError:
        return None
    for entry in entries:
        if entry.name not in leave and not entry.name.startswith((_NEW, _OLD)):
            _link(entry, new / entry.name)
    return was, {entry.name for entry in entries}


def _follow(old: Path, path: Path, carried: tuple[os.stat_result, set[str]] | None, leave: Collection[str]) -> None:
    """Move files that came into the old folder meanwhile, unless the old folder is now another program's result."""
    with suppress(FileNotFoundError):
        if carried is None or not os.path.samestat(old.stat(), carried[0]):
            return
        for entry in list(old.iterdir()):
            if entry.name not in {*carried[1], *leave} and not entry.name.startswith((_NEW, _OLD)):
                entry.rename(path / entry.name)


def _link(source: Path, target: Path) -> None:
    if source.is_dir() and not source.is_symlink():
        if source.is_mount():
            raise OSError(errno.EBUSY, f"{source.name} in it is a mount point")
        target.mkdir(exist_ok=True)
        for entry in source.iterdir():
            _link(entry, target / entry.name)
        shutil.copystat(source, target)
        return
    try:
        os.link(source, target, follow_symlinks=False)
    except (FileNotFoundError, FileExistsError):  # deleted meanwhile, or linked already
        return
    except OSError:  # a file system without hard links
        shutil.copy2(source, target, follow_symlinks=False)
