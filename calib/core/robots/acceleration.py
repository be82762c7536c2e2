"""The choice between compiled code and Python for kinematics.

Compiled code needs numba (the extra `fast`), which takes half a second to load, more than most fits take, and about
five to compile, once for each version. So compiled code is used only on request by `compile_kinematics()`, or if the
number of poses pays for it: for loading what an earlier program has compiled, or else for compiling as well. Everything
works without it, with the same numbers to 1e-12. The code is that of `calib.compiled`, found by the entry point
`compiled_kinematics` of the group `calib.methods`.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from functools import cache
from importlib.util import find_spec
from typing import Any

from calib.core.base.registry import load_entry
from calib.core.base.words import warn_once
from calib.core.robots.mechanism import Mechanism

_MANY = 5000  # number of poses, with loops, for which loading numba pays: each pose of a fit saves 0.1 ms
_MANY_OPEN = 20_000  # number of poses without loops, and of draws, where a pose saves 0.03 ms
_TO_COMPILE = 7  # factor on these numbers if the functions must be compiled first
_AVAILABLE = find_spec("numba") is not None
_requested: ContextVar[bool | None] = ContextVar("compiled kinematics", default=None)


@contextmanager
def compile_kinematics(use: bool = True) -> Iterator[None]:
    """In the block, compute kinematics by compiled code if numba is installed; or never."""
    before = _requested.set(use)
    try:
        yield
    finally:
        _requested.reset(before)


def compile_for(n_poses: int, many: int = _MANY_OPEN) -> AbstractContextManager[None]:
    """In the block, use compiled code if that is faster for `n_poses`, one part after the other, unless a caller
    decides; code that is already compiled is worth loading for `many` poses.
    """
    return compile_kinematics() if _requested.get() is None and pays(n_poses, many) else nullcontext()


def pays(n_poses: int, many: int = _MANY_OPEN) -> bool:
    """Whether compiled code saves more time than it takes, if so many poses have to be computed; see `compile_for`."""
    return _AVAILABLE and n_poses >= many and (n_poses >= _TO_COMPILE * many or _functions().is_compiled())


def many(mechanism: Mechanism) -> int:
    """Return the number of poses of a robot, at once or batch after batch, from which loading compiled code pays."""
    return _MANY if mechanism.loops else _MANY_OPEN


def compilation_requested() -> bool:
    """Whether compiled code was requested: passed on to other processes."""
    return _requested.get() is True


def kernels(mechanism: Mechanism, n_poses: int) -> Any:
    """Return the compiled functions if they are to be used for so many poses at once, else None.

    Loops that constrain directions are left to the reference.
    """
    requested = _requested.get()
    use = pays(n_poses, many(mechanism)) if requested is None else requested
    if not (use and _AVAILABLE) or any(loop.full_pose for loop in mechanism.loops):
        return None
    _tell_compiling()
    return _functions()


@cache
def _tell_compiling() -> None:
    """Say once that functions will be compiled, because no stored code was found."""
    if not _functions().is_compiled("*"):
        warn_once("numba compiles the kinematics; this takes about 5 s, once for each version")


@cache
def _functions() -> Any:
    return load_entry("calib.methods", "compiled_kinematics")
