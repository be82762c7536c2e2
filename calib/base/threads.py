"""One BLAS thread for small matrices.

The matrices of a calibration are small (a few hundred rows per pose chunk, tens of columns). Several BLAS threads then
wait for each other more than they compute, and on a busy machine much more: a fit of 159 poses took 0.1 s with one
thread and 0.7 to 8 s with two, measured on two busy cores. Parallel work belongs into processes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

P = ParamSpec("P")
R = TypeVar("R")


def one_blas_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Decorate a function to run with one BLAS thread; the setting is restored afterwards."""
    limited: Callable[P, R] = threadpool_limits.wrap(limits=1, user_api="blas")(function)
    return limited
