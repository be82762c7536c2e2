"""Sharing independent work over processes, with the same results in the same order as without.

The processes end with the program that started them, however it ends: after Ctrl-C, SIGTERM or SIGHUP they are stopped
before the program is left, and where it dies without a chance to do so (SIGKILL), each of them notices by itself.

SIGTERM and SIGHUP end the program from within the handler. An exception raised there would land anywhere, also between
taking and releasing a lock of the pool, and one program in some hundred would then wait for ever.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing.process import BaseProcess
from types import FrameType, TracebackType
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

_ENDING = (signal.SIGTERM, signal.SIGHUP)


class Workers:
    """Processes that live as long as the `with` block.

    They start at once, so that they are ready when the work is.

    Args:
        jobs: Number of processes; with 1 everything runs in this one.
    """

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs
        self._pool: ProcessPoolExecutor | None = None
        self._processes: list[BaseProcess] = []
        self._handlers: dict[signal.Signals, object] = {}

    def __enter__(self) -> Workers:
        if self._jobs > 1:
            if threading.current_thread() is threading.main_thread():
                # what is ignored, as SIGHUP under nohup, stays ignored
                heard = [number for number in _ENDING if signal.getsignal(number) != signal.SIG_IGN]
                self._handlers = {number: signal.signal(number, self._end) for number in heard}
            others = set(multiprocessing.active_children())
            # fresh processes: a forked one would inherit threads of the linear algebra
            context = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(self._jobs, mp_context=context, initializer=_end_with_parent)
            with _without_interrupts():
                for _ in range(self._jobs):
                    self._pool.submit(_nothing)
            self._processes = [one for one in multiprocessing.active_children() if one not in others]
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._pool is not None:
            if error is not None:
                for process in self._processes:
                    process.kill()
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None
        for number, handler in self._handlers.items():
            signal.signal(number, handler)  # type: ignore[arg-type]  # what signal.signal gave

    def _end(self, number: int, frame: FrameType | None) -> None:
        """Stop the processes, and end the program as the signal does by itself."""
        for process in self._processes:
            process.kill()
        if sys.stderr.isatty():
            os.write(sys.stderr.fileno(), b"\x1b[?25h")  # show the cursor, which a progress display hides
        signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)

    def in_order(self, function: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Result]:
        """Yield the function's results, first item first.

        Args:
            function: Of a module, so that other processes find it.
            items: What to call it with.
        """
        return map(function, items) if self._pool is None else self._pool.map(function, items)


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """Let processes that are started inside ignore Ctrl-C: whoever started them decides when they end."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _nothing() -> None:
    """Make the pool start a process."""


def _end_with_parent() -> None:
    """End this process as soon as the one that started it is gone."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, name="end with parent", daemon=True).start()
