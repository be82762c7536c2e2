"""One BLAS thread for small matrices.

The matrices of a calibration are small (a few hundred rows per pose chunk, tens of columns). Several BLAS threads then
wait for each other more than they compute, and on a busy machine much more: a fit of 159 poses took 0.1 s with one
thread and 0.7 to 8 s with two, measured on two busy cores. Parallel work belongs into processes.
"""

from __future__ import annotations

from collections.abc import Callable
from contextvars import ContextVar
from functools import cache, wraps
from importlib import import_module
from typing import ParamSpec, TypeVar

from threadpoolctl import LibController, ThreadpoolController

P = ParamSpec("P")
R = TypeVar("R")

_limited: ContextVar[bool] = ContextVar("one BLAS thread", default=False)


def one_blas_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Decorate a function to run with one BLAS thread; the setting is restored afterwards.

    The limit also holds in all functions that it calls.
    """

    @wraps(function)
    def limited(*args: P.args, **options: P.kwargs) -> R:
        if _limited.get():
            return function(*args, **options)
        before = _limited.set(True)
        several = [(library, n) for library in _libraries() if (n := library.num_threads) != 1]
        try:
            for library, _ in several:
                library.set_num_threads(1)
            return function(*args, **options)
        finally:
            for library, n in several:
                library.set_num_threads(n)
            _limited.reset(before)

    return limited


@cache
def _libraries() -> list[LibController]:
    """The BLAS of NumPy and of SciPy, both loaded now; the search takes a millisecond, so it is done once."""
    import_module("scipy.linalg")
    return list(ThreadpoolController().select(user_api="blas").lib_controllers)
