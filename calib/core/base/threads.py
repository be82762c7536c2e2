"""One BLAS thread for small matrices.

The matrices of a calibration are small (a few hundred rows per pose chunk, tens of columns). Several BLAS threads then
wait for each other more than they compute, and on a busy machine much more: a fit of 159 poses took 0.1 s with one
thread and 0.7 to 8 s with two, measured on two busy cores. Parallel work belongs into processes.
"""

from __future__ import annotations

from collections.abc import Callable
from contextvars import ContextVar
from functools import wraps
from importlib import import_module
from typing import ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

P = ParamSpec("P")
R = TypeVar("R")

_limited: ContextVar[bool] = ContextVar("one BLAS thread", default=False)


def one_blas_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Decorate a function to run with one BLAS thread; the setting is restored afterwards.

    A limit holds for the libraries that are loaded when the function is called. SciPy brings a BLAS of its own, with
    its first use, which may be inside the function: so it is loaded before. A limit takes a quarter of a millisecond:
    functions that such a function calls have it already.
    """

    @wraps(function)
    def with_all_loaded(*args: P.args, **options: P.kwargs) -> R:
        if _limited.get():
            return function(*args, **options)
        import_module("scipy.linalg")
        before = _limited.set(True)
        try:
            with threadpool_limits(limits=1, user_api="blas"):
                return function(*args, **options)
        finally:
            _limited.reset(before)

    return with_all_loaded
