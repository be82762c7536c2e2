"""Independent work shared over workers: the same results, in the same order, however many there are.

Workers are any `concurrent.futures` executor: threads, processes of this machine (`Workers`), or those of a cluster
(docs/howto/many_calibrations.md). An error of the work travels as a value, so that whatever else a future raises means
one thing: its worker was lost. What is done is kept, what was lost is sent again. Where the executor takes no more work
because losing a worker has broken it, the rest is done here.

The processes of `Workers` end with the program that started them, however it ends: after Ctrl-C, SIGTERM or SIGHUP they
are stopped before the program is left, and where it dies without a chance to do so (SIGKILL), each of them notices by
itself. SIGTERM and SIGHUP end the program from within the handler. An exception raised there would land anywhere, also
between taking and releasing a lock of the pool, and one program in some hundred would then wait for ever.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.process import BaseProcess
from types import FrameType, TracebackType
from typing import Any, TypeVar, cast

from calib.errors import ComputationError

Item = TypeVar("Item")
Result = TypeVar("Result")

_ENDING = (signal.SIGTERM, signal.SIGHUP)
_LOSSES = 3  # of the same piece of work in a row; the work itself then ends its workers


def in_order(function: Callable[[Item], Result], items: Sequence[Item], executor: Executor | None) -> Iterator[Result]:
    """Yield the function's results, first item first.

    Args:
        function: Of a module, so that other processes find it.
        items: What to call it with.
        executor: Who works; this process if not given.

    Raises:
        ComputationError: The same piece of work was lost several times.
    """
    if executor is None:
        yield from map(function, items)
        return
    futures = [_sent(executor, function, item) for item in items]
    try:
        for k in range(len(items)):
            yield _result(k, function, items, executor, futures)
            futures[k] = None  # what came out of it is not kept twice
    finally:
        for left in futures:
            if left is not None:
                left.cancel()


_Sent = Future[tuple[bool, Any]] | None


def _result(
    k: int, function: Callable[[Item], Result], items: Sequence[Item], executor: Executor, futures: list[_Sent]
) -> Result:
    """Wait for item k; send what was lost meanwhile again."""
    for losses in range(1, _LOSSES + 1):
        future = futures[k]
        if future is None:
            return function(items[k])
        try:
            succeeded, result = future.result()
        except Exception as lost:
            if losses == _LOSSES:
                raise ComputationError(
                    f"workers were lost {losses} times at the same work ({type(lost).__name__}: {lost}); is there"
                    " enough memory for each of them?"
                ) from lost
            for other in range(k, len(items)):
                if _is_lost(futures[other]):
                    futures[other] = _sent(executor, function, items[other])
            continue
        if succeeded:
            return cast(Result, result)
        raise result
    raise AssertionError("the last loss raises")


def _sent(executor: Executor, function: Callable[[Item], Result], item: Item) -> _Sent:
    """A future, or None where the executor takes no more work."""
    try:
        return executor.submit(_answer, function, item)
    except RuntimeError:  # a broken executor, or one that was shut down
        return None


def _answer(function: Callable[[Item], Result], item: Item) -> tuple[bool, Any]:
    """The result, or the error as a value."""
    try:
        return True, function(item)
    except Exception as error:
        return False, error


def _is_lost(future: _Sent) -> bool:
    return future is not None and future.done() and (future.cancelled() or future.exception() is not None)


class Workers:
    """Processes that live as long as the `with` block, which gives their executor; None where this one does the work.

    They start at once, so that they are ready when the work is. Programs that start some need the usual
    `if __name__ == "__main__"`, because each process imports them again.

    Args:
        jobs: Number of processes; with 1 everything runs in this one.
    """

    def __init__(self, jobs: int) -> None:
        self._processes = _Processes(jobs) if jobs > 1 else None
        self._handlers: dict[signal.Signals, object] = {}

    def __enter__(self) -> Executor | None:
        if self._processes is not None:
            if threading.current_thread() is threading.main_thread():
                # what is ignored, as SIGHUP under nohup, stays ignored
                heard = [number for number in _ENDING if signal.getsignal(number) != signal.SIG_IGN]
                self._handlers = {number: signal.signal(number, self._end) for number in heard}
            self._processes.start()
        return self._processes

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._processes is not None:
            if error is not None:
                self._processes.kill()
            self._processes.shutdown(wait=True, cancel_futures=True)
        for number, handler in self._handlers.items():
            signal.signal(number, handler)  # type: ignore[arg-type]  # what signal.signal gave

    def _end(self, number: int, frame: FrameType | None) -> None:
        """Stop the processes, and end the program as the signal does by itself."""
        if self._processes is not None:
            self._processes.kill()
        if sys.stderr.isatty():
            os.write(sys.stderr.fileno(), b"\x1b[?25h")  # show the cursor, which a progress display hides
        signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)


class _Processes(Executor):
    """A pool of processes that starts others in their place where some are lost.

    Args:
        jobs: How many.
    """

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs
        self._pool: ProcessPoolExecutor | None = None
        self._children: list[BaseProcess] = []

    def start(self) -> ProcessPoolExecutor:
        """Start the processes."""
        others = set(multiprocessing.active_children())
        # fresh processes: a forked one would inherit threads of the linear algebra
        context = multiprocessing.get_context("spawn")
        self._pool = pool = ProcessPoolExecutor(self._jobs, mp_context=context, initializer=_end_with_parent)
        with _without_interrupts():
            for _ in range(self._jobs):
                pool.submit(_nothing)
        self._children = [one for one in multiprocessing.active_children() if one not in others]
        return pool

    def submit(self, function: Callable[..., Result], /, *arguments: Any, **named: Any) -> Future[Result]:
        """See `concurrent.futures.Executor`."""
        if self._pool is None:
            raise RuntimeError("these processes have been ended")
        try:
            return self._pool.submit(function, *arguments, **named)
        except BrokenProcessPool:
            self._pool.shutdown(wait=True, cancel_futures=True)
            return self.start().submit(function, *arguments, **named)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """See `concurrent.futures.Executor`."""
        if self._pool is not None:
            self._pool.shutdown(wait=wait, cancel_futures=cancel_futures)
            self._pool = None

    def kill(self) -> None:
        """End the processes, whatever they do."""
        for process in self._children:
            process.kill()


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
