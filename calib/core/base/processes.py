"""Processes of this machine as an executor without threads and locks in the program itself.

Each process has a pipe of its own. Free processes get work while the program waits for a result. So an exception can be
raised anywhere, as Ctrl-C does, and the processes can be ended at any moment: no lock and no half-sent result makes the
program wait for ever. In `concurrent.futures.ProcessPoolExecutor` a thread reads the results, and if a process dies
while it sends a result, the thread waits for the rest of it.

A process holds the last function that it got. So a function that many pieces of work share, as one object that does
not change, is sent to each process once. A process ends with the program that started it, even if that was killed.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from multiprocessing import connection, resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

Result = TypeVar("Result")
_Work = tuple[Callable[..., Any], tuple[Any, ...], dict[str, Any]]


class Processes(Executor):
    """A number of processes that work while a result is awaited; lost ones are replaced."""

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs
        self._processes: dict[Connection, BaseProcess] = {}
        self._busy: dict[Connection, Future[Any]] = {}
        self._waiting: deque[tuple[Future[Any], _Work]] = deque()
        self._held: dict[Connection, Callable[..., Any]] = {}

    def start(self) -> None:
        """Start the processes that are missing."""
        context = multiprocessing.get_context("spawn")  # a forked one would inherit threads of the linear algebra
        with _without_interrupts():
            while len(self._processes) < self._jobs:
                here, there = context.Pipe()
                process = context.Process(target=_work, args=(there,), daemon=True)
                process.start()
                there.close()
                self._processes[here] = process

    def submit(self, function: Callable[..., Result], /, *arguments: Any, **named: Any) -> Future[Result]:
        """See `concurrent.futures.Executor`."""
        if not self._processes:
            raise RuntimeError("these processes have been ended")
        future = _PendingResult[Result](self)
        self._waiting.append((future, (function, arguments, named)))
        self._send()
        return future

    def proceed(self) -> None:
        """Wait until a piece of work is done, and give out more."""
        self._send()
        answering = connection.wait(list(self._busy))
        for line in [line for line in self._busy if line in answering]:
            future = self._busy.pop(line)
            try:
                answer = line.recv_bytes()
            except (EOFError, OSError):  # the process is gone, perhaps half-way through its answer
                future.set_exception(self._replace_process(line))
                continue
            try:
                error, result = pickle.loads(answer)
            except Exception as unreadable:
                error = unreadable
            if error is None:
                future.set_result(result)
            else:
                self._held.pop(line, None)  # the process may not have been able to read the function
                future.set_exception(error)
        self._send()

    def _send(self) -> None:
        """Give work to free processes."""
        for line in [line for line in self._processes if line not in self._busy]:
            while self._waiting and line not in self._busy:
                future, (function, arguments, named) = self._waiting.popleft()
                if not future.set_running_or_notify_cancel():
                    continue
                try:
                    line.send((None if self._held.get(line) is function else function, arguments, named))
                    self._held[line] = function
                except ConnectionError:
                    future.set_exception(self._replace_process(line))
                    break
                except Exception as error:  # work that cannot be sent
                    future.set_exception(error)
                    continue
                self._busy[line] = future

    def _replace_process(self, line: Connection) -> Exception:
        """Replace a process, and say how it ended."""
        process = self._processes.pop(line)
        self._held.pop(line, None)
        line.close()
        process.join()
        self.start()
        return ProcessLookupError(f"a process ended with exit code {process.exitcode}")

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = True) -> None:
        """End the processes, whatever they do; their results are no longer awaited."""
        self.kill()
        for line, process in self._processes.items():
            process.join()
            line.close()
        for future in (*self._busy.values(), *(future for future, _ in self._waiting)):
            if not future.cancel():
                future.set_exception(ProcessLookupError("the processes were ended"))
        self._processes, self._busy, self._held = {}, {}, {}
        self._waiting.clear()

    def kill(self) -> None:
        """Tell the processes to end, and wait for nothing."""
        for process in self._processes.values():
            process.kill()


class _PendingResult(Future[Result]):
    """A result; while the program waits for it, the processes proceed."""

    def __init__(self, processes: Processes) -> None:
        super().__init__()
        self._processes = processes

    def result(self, timeout: float | None = None) -> Result:
        """See `concurrent.futures.Future`; it waits as long as it takes."""
        while not self.done():
            self._processes.proceed()
        return super().result()


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """Let processes that are started inside never get Ctrl-C: the program that started them decides when they end.

    They inherit the blocked signal. This process gets it at the end of the block.
    """
    resource_tracker.ensure_running()  # started now, since its start lets the signal through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _work(line: Connection) -> None:
    """Do the work that comes through the pipe, until the pipe ends."""
    _end_with_parent()
    held: Any = None
    while True:
        try:
            function, arguments, named = line.recv()
        except (EOFError, OSError):
            return
        except Exception as error:  # work that cannot be read, such as a function that is not in a module
            line.send((error, None))
            continue
        held = held if function is None else function
        try:
            line.send((None, held(*arguments, **named)))
        except Exception as error:  # an error of the work, or a result that cannot be sent
            line.send((error, None))


def _end_with_parent() -> None:
    """End this process as soon as the one that started it is gone."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, name="end with parent", daemon=True).start()
