"""Free memory, and arrays that may be larger than that."""

from __future__ import annotations

import math
import os
import shutil
import tempfile
from pathlib import Path

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import InputError


def zeros_with_room(shape: tuple[int, ...], what: str) -> FloatArray:
    """Return zeros of a shape (n, ...); where they would take more than half of the free memory, in a file without a
    name.

    The system reads and writes the parts of the file that are looked at, so that what goes through the array part by
    part needs little memory. The file is gone with the array, however the program ends. `InputError` if the folder of
    temporary files has no room either; `what` names the content.
    """
    needed = 8 * math.prod(shape)
    if 2 * needed <= free_memory():
        return np.zeros(shape)
    folder = tempfile.gettempdir()
    with tempfile.TemporaryFile() as file:
        try:
            # the place itself, since a full disk would end the program at the first write
            os.posix_fallocate(file.fileno(), 0, needed) if hasattr(os, "posix_fallocate") else file.truncate(needed)
        except OSError:
            raise InputError(
                f"{what} need {needed / 1e9:.2g} GB, which is more than half of the free memory, and {folder} has only"
                f" {shutil.disk_usage(folder).free / 1e9:.2g} GB free; name a folder with more room in TMPDIR"
            ) from None
        return np.asarray(np.memmap(file, dtype=float, mode="r+", shape=shape))


def require_memory(numbers: int, what: str, advice: str) -> None:
    """Raise `InputError` with advice on what to do where so many numbers of 8 bytes do not fit into the free memory."""
    needed, free = 8.0 * numbers, free_memory()
    if needed > free:
        raise InputError(
            f"{what} needs about {needed / 1e9:.2g} GB of memory, and {free / 1e9:.2g} GB are free; {advice}"
        )


def free_memory() -> float:
    """Return how many bytes a program can still take, from the machine or its container; infinite if neither says."""
    limits = [float("inf")]
    for line in _lines("/proc/meminfo"):
        if line.startswith("MemAvailable:"):
            limits.append(1024.0 * int(line.split()[1]))
    limit, used = (_lines(f"/sys/fs/cgroup/memory.{name}") for name in ("max", "current"))
    if limit and used and limit[0].isdecimal():
        limits.append(max(float(limit[0]) - float(used[0]), 0.0))
    return min(limits)


def _lines(path: str) -> list[str]:
    """The lines of a file of the system; none where there is no such file."""
    try:
        return Path(path).read_text(encoding="ascii").splitlines()
    except OSError:
        return []
