"""Independent work shared over workers: the same results, in the same order, however many there are.

Workers are any `concurrent.futures` executor: threads, processes of this machine (a number), or those of a cluster
(docs/howto/many_calibrations.md). Everything that shares work takes it as `executor`, and passes it through `Workers`
to `results_in_order`. An error of the work travels as a value, so that whatever else a future raises means one thing:
its worker was lost. Finished work is kept, lost work is sent again. Where the executor takes no more work because
losing a worker has broken it, the rest is done here. Data that all pieces of work share, such as the first fit of a
study, go to each worker once, if the executor can hold them (processes of `Workers`, and those of Dask); otherwise they
go with every piece.

The processes of `Workers` end with the program that started them: after Ctrl-C, SIGTERM or SIGHUP they are stopped
before the program is left; after SIGKILL, each of them notices by itself (`calib.core.base.processes`).
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future
from functools import partial
from types import FrameType, TracebackType
from typing import Any, TypeVar, cast

from calib.core.base.errors import ComputationError, InputError
from calib.core.base.processes import Processes

Item = TypeVar("Item")
Result = TypeVar("Result")
Progress = Callable[[int, int], None]
"""Called with the number of finished pieces of work, and the number of all pieces."""

_ENDING = (signal.SIGTERM, signal.SIGHUP)
_AHEAD = 256  # pieces of work sent at a time: each carries what it needs, and its result waits for those before it
_LOSSES = 3  # losses of one piece of work in a row after which the work is the cause


def results_in_order(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    executor: Executor | None,
    progress: Progress | None = None,
) -> Iterator[Result]:
    """Yield the function's results, first item first; this process computes them if no executor is given.

    At most `_AHEAD` items are with the executor at a time, so that its memory does not grow with their number. The
    function holds the data that all pieces share. It is a function of a module, so that other processes find it;
    neither it nor the caller may change its input. `progress` is told after each item. A piece of work that is lost
    several times is a `ComputationError`.
    """
    futures = dict[int, _Sent]()
    send = None if executor is None else _sender(executor, function)
    try:
        for k in range(len(items)):
            if executor is None or send is None:
                result = function(items[k])
            else:
                for more in range(k + len(futures), min(k + _AHEAD, len(items))):
                    futures[more] = _try_send(send, items[more])
                result = _result(k, function, items, executor, futures)
                del futures[k]  # what came out of it is not kept twice
            if progress is not None:
                progress(k + 1, len(items))
            yield result
    finally:
        for left in futures.values():
            if left is not None:
                left.cancel()


_Answer = tuple[bool, Any]
_Sent = Future[_Answer] | None
_Send = Callable[[Item], Future[_Answer]]


def _result(
    k: int, function: Callable[[Item], Result], items: Sequence[Item], executor: Executor, futures: dict[int, _Sent]
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
                    f"workers ended {losses} times at the same work ({type(lost).__name__}: {lost}). Give each of them"
                    " more memory; put functions of your own into a module; start processes under"
                    " `if __name__ == '__main__':`"
                ) from lost
            for other, sent in futures.items():
                if sent is not None and sent.done() and (sent.cancelled() or sent.exception() is not None):
                    futures[other] = _try_send(partial(executor.submit, partial(_answer, function)), items[other])
            continue
        if succeeded:
            return cast(Result, result)
        raise result
    raise AssertionError("the last loss raises")


def _sender(executor: Executor, function: Callable[[Item], Result]) -> _Send[Item]:
    """A function that sends an item to the workers: without `function`, if the workers hold that already."""
    client = getattr(executor, "_client", None)  # executors of Dask have one
    if hasattr(client, "scatter"):
        held = cast(Any, client).scatter(function, broadcast=True, hash=False)
        return lambda item: executor.submit(_answer, held, item)
    return partial(executor.submit, partial(_answer, function))


def _try_send(send: _Send[Item], item: Item) -> _Sent:
    """A future, or None where the executor takes no more work."""
    try:
        return send(item)
    except RuntimeError:  # a broken executor, or one that was shut down
        return None


def _answer(function: Callable[[Item], Result], item: Item) -> tuple[bool, Any]:
    """The result, or the error as a value."""
    try:
        return True, function(item)
    except Exception as error:
        return False, error


class Steps:
    """Counts the steps of a long call, done and known so far, and tells `progress` after each."""

    def __init__(self, progress: Progress | None = None) -> None:
        self._progress = progress
        self._done = self._total = 0

    def expect(self, count: int) -> None:
        """Count further steps among those to do."""
        self._total += count

    def restart(self, count: int) -> None:
        """Expect `count` steps from here on, in place of those that were expected."""
        self._total = self._done + count

    def advance(self, *_: int) -> None:
        """Count one more step as done; may be given as the `Progress` of a part of the call."""
        self._done += 1
        if self._progress is not None:
            self._progress(self._done, self._total)


class Workers:
    """Workers for a `with` block, which gives the executor; None where this process does the work.

    Processes of its own live as long as the block. They start at once, so that they are ready when the work is.
    Programs that start some need the usual `if __name__ == "__main__"`, because each process imports them again.

    Args:
        executor: An executor, which stays as it is; or a number of processes. With 1 or None, everything runs in this
            process.
        pieces: How many pieces of work there will be at most, if that is known: no more processes than these start.

    Raises:
        InputError: The executor is something else, or the number is below 1.
    """

    def __init__(self, executor: Executor | int | None, pieces: int | None = None) -> None:
        jobs = executor if isinstance(executor, int) else 1
        if jobs < 1 or not isinstance(executor, Executor | int | None):
            raise InputError(
                f"executor {executor!r:.60}: must be an executor of concurrent.futures, or a number of processes,"
                " 1 or more"
            )
        self._given = executor if isinstance(executor, Executor) else None
        jobs = jobs if pieces is None else min(jobs, pieces)
        self._processes = Processes(jobs) if jobs > 1 else None
        self._handlers: dict[signal.Signals, object] = {}

    def __enter__(self) -> Executor | None:
        if self._processes is not None:
            if threading.current_thread() is threading.main_thread():
                # what is ignored, as SIGHUP under nohup, stays ignored
                heard = [number for number in _ENDING if signal.getsignal(number) != signal.SIG_IGN]
                self._handlers = {number: signal.signal(number, self._end) for number in heard}
            try:
                self._processes.start()
            except BaseException:
                self.__exit__(*sys.exc_info())
                raise
        return self._given if self._processes is None else self._processes

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._processes is not None:
            self._processes.shutdown()
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
