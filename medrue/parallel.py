"""Sharing independent work over processes, with the same results in the same order as without."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from types import TracebackType
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


class Workers:
    """Processes that live as long as the `with` block.

    Args:
        jobs: Number of processes; with 1 everything runs in this one.
    """

    def __init__(self, jobs: int) -> None:
        # fresh processes: a forked one would inherit threads of the linear algebra
        context = multiprocessing.get_context("spawn")
        self._pool = ProcessPoolExecutor(jobs, mp_context=context) if jobs > 1 else None

    def __enter__(self) -> Workers:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)

    def in_order(self, function: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Result]:
        """Yield the function's results, first item first.

        Args:
            function: Of a module, so that other processes find it.
            items: What to call it with.
        """
        return map(function, items) if self._pool is None else self._pool.map(function, items)
