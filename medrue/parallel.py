"""Sharing independent work over processes, with the same results in the same order as without.

The program itself has neither threads nor locks for this: each process has a pipe of its own, and the program sends an
item to whoever is free. So an exception can be raised anywhere, as Ctrl-C does, and nothing that it left locked makes
the program wait for ever.

The processes end with the program that started them, however it ends: after Ctrl-C, SIGTERM or SIGHUP they are stopped
before the program is left, and where it dies without a chance to do so (SIGKILL), each of them notices by itself.
SIGTERM and SIGHUP end the program from within the handler.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import connection, resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from types import FrameType, TracebackType
from typing import Any, TypeVar

from calib.errors import ComputationError

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
        self._processes: dict[Connection, BaseProcess] = {}
        self._busy: dict[Connection, tuple[object, int]] = {}  # with which call of `in_order`, and which of its items
        self._handlers: dict[signal.Signals, object] = {}

    def __enter__(self) -> Workers:
        if self._jobs > 1:
            if threading.current_thread() is threading.main_thread():
                # what is ignored, as SIGHUP under nohup, stays ignored
                heard = [number for number in _ENDING if signal.getsignal(number) != signal.SIG_IGN]
                self._handlers = {number: signal.signal(number, self._end) for number in heard}
            try:
                with _without_interrupts():
                    for _ in range(self._jobs):
                        self._start()
            except BaseException:
                self.__exit__(*sys.exc_info())
                raise
        return self

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")  # a forked one would inherit threads of the linear algebra
        here, there = context.Pipe()
        process = context.Process(target=_work, args=(there,), daemon=True)
        process.start()
        there.close()
        self._processes[here] = process

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        for line, process in self._processes.items():
            process.kill()
            process.join()
            line.close()
        self._processes, self._busy = {}, {}
        for number, handler in self._handlers.items():
            signal.signal(number, handler)  # type: ignore[arg-type]  # what signal.signal gave

    def _end(self, number: int, frame: FrameType | None) -> None:
        """Stop the processes, and end the program as the signal does by itself."""
        for process in self._processes.values():
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

        Raises:
            ComputationError: A process was ended from outside.
        """
        if not self._processes:
            yield from map(function, items)
            return
        call, waiting, done = object(), iter(enumerate(items)), dict[int, tuple[bool, Any]]()
        for wanted in range(len(items)):
            while wanted not in done:
                for line in [line for line in self._processes if line not in self._busy]:
                    for index, item in waiting:
                        line.send((function, item))
                        self._busy[line] = (call, index)
                        break
                answering = connection.wait(list(self._busy))
                for line in [line for line in self._busy if line in answering]:
                    answer = self._answer(line)
                    asked, index = self._busy.pop(line)
                    if asked is call:  # and not one that was left half-way
                        done[index] = answer
            good, result = done.pop(wanted)
            if not good:
                raise result
            yield result

    def _answer(self, line: Connection) -> tuple[bool, Any]:
        """Whether a process could do its work, and the result or the error."""
        try:
            return line.recv()
        except (EOFError, ConnectionError):
            self._processes[line].join()
            code = self._processes[line].exitcode
            raise ComputationError(
                f"a process that shared the work was ended (exit code {code}); if memory was short, --jobs 1 needs less"
            ) from None


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """Let processes that are started inside never hear Ctrl-C: whoever started them decides when they end.

    They inherit that the signal is held back. Here it is heard at the end of the block.
    """
    resource_tracker.ensure_running()  # which would let the signal through again when it starts
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _work(line: Connection) -> None:
    """Answer what is asked, until nobody can ask any more."""
    _end_with_parent()
    while True:
        try:
            function, item = line.recv()
        except EOFError:
            return
        try:
            answer = True, function(item)
        except Exception as error:
            error.add_note(traceback.format_exc())
            answer = False, error
        line.send(answer)


def _end_with_parent() -> None:
    """End this process as soon as the one that started it is gone."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, name="end with parent", daemon=True).start()
