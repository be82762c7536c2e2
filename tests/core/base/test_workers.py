"""Shared work: results in order, nothing lost with a worker, processes that end with the program that started them."""

import math
import multiprocessing
import os
import random
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path

import pytest

from calib.core.base.errors import ComputationError
from calib.core.base.workers import Workers, results_in_order
from tests.child_programs import start
from tests.core.base.killed_workers import outcome

PROGRAM = """
import signal, sys, time
from calib.core.base.workers import Workers, results_in_order

if __name__ == "__main__":
    signal.signal(signal.SIGHUP, signal.SIG_IGN if "nohup" in sys.argv else signal.SIG_DFL)
    with Workers(2) as executor:
        print(*results_in_order(abs, [-1, -2], executor), flush=True)
        list(results_in_order(time.sleep, [120.0, 120.0, 120.0], executor))
"""


ALWAYS_SENDING = """
import sys

try:
    from calib.core.base.workers import Workers, results_in_order

    if __name__ == "__main__":
        print(1, 2, flush=True)
        with Workers(2) as executor:
            while True:
                list(results_in_order(bytes, [300_000] * 20, executor))
except KeyboardInterrupt:
    sys.exit(130)
"""

BUSY = 60.0
"""More seconds than a busy machine needs for anything here; the work takes twice as long."""


@contextmanager
def started(
    folder: Path, *arguments: str, text: str = PROGRAM, group: bool = False
) -> Iterator[tuple[subprocess.Popen[bytes], int]]:
    """The program at work, and the reading end of the pipe that it and its processes write to."""
    script = folder / "program.py"
    script.write_text(text)
    reading, writing = os.pipe()
    command = [sys.executable, script, *arguments]
    program = start(command, stdout=writing, stderr=subprocess.DEVNULL, start_new_session=group)
    os.close(writing)
    try:
        said, byte = b"", b" "
        while byte not in (b"\n", b"") and select.select([reading], [], [], BUSY)[0]:
            byte = os.read(reading, 1)
            said += byte
        assert said == b"1 2\n"
        yield program, reading
    finally:
        program.kill()
        program.wait(BUSY)
        os.close(reading)


def ended(pipe: int) -> bool:
    """Whether nobody holds the writing end of the pipe any more."""
    return bool(select.select([pipe], [], [], BUSY)[0]) and os.read(pipe, 1) == b""


class Forgetful(Executor):
    """Works at once, but loses some of what it was sent."""

    def __init__(self, lost: list[int]) -> None:
        self.lost, self.sent = lost, list[int]()

    def submit(self, function, /, *arguments, **named):  # type: ignore[no-untyped-def]
        future: Future[object] = Future()
        item = arguments[-1]
        self.sent.append(item)
        if item in self.lost:
            self.lost.remove(item)
            future.set_exception(OSError("the computer was switched off"))
        else:
            future.set_result(function(*arguments, **named))
        return future


def dies_once(task: tuple[str, str, int]) -> bytes:
    """Return some bytes; the first worker that is asked for the third dies, or when half of its answer is sent."""
    folder, moment, number = task
    grave = Path(folder) / "grave"

    def send_half(line: Connection, message: bytes) -> None:
        os.write(line.fileno(), message[: len(message) // 2])
        os.kill(os.getpid(), signal.SIGKILL)

    if number == 2 and not grave.exists():
        grave.touch()
        if moment == "at once":
            os.kill(os.getpid(), signal.SIGKILL)
        Connection._send = send_half  # type: ignore[attr-defined]
    return bytes([number] * 1000)


@pytest.mark.amount(1, 3)
def test_programs_of_which_a_worker_is_killed_at_any_moment_end_with_all_results(amount: int) -> None:
    chance = random.Random(1)
    assert [outcome(chance, BUSY) for _ in range(amount)] == ["complete"] * amount


class Unreadable:
    """Can be sent, and not be read again."""

    def __reduce__(self) -> tuple[object, ...]:
        return (int, ("no number",))


def unreadable(_: int) -> Unreadable:
    return Unreadable()


class Shared:
    """What all pieces of work share; counts how often it is sent."""

    sent = 0

    def __init__(self, factor: int) -> None:
        self.factor = factor

    def __reduce__(self):
        Shared.sent += 1
        return Shared, (self.factor,)

    def __call__(self, item: int) -> int:
        return self.factor * item


def test_results_come_in_the_order_of_the_items() -> None:
    items = [-3, 1, -2, 5]
    for executor in (None, 1, 2, ThreadPoolExecutor(2)):
        with Workers(executor) as workers:
            assert list(results_in_order(abs, items, workers)) == [3, 1, 2, 5]


def test_there_are_no_more_processes_than_pieces_of_work() -> None:
    for jobs, pieces in ((8, 1), (1, None)):
        with Workers(jobs, pieces=pieces) as executor:
            assert executor is None
    with Workers(8, pieces=2) as executor:
        assert next(results_in_order(abs, [-1, -2, -3, -4], executor)) == 1
        assert len(multiprocessing.active_children()) == 2
        assert list(results_in_order(abs, [-5, -6, -7], executor)) == [5, 6, 7]  # without those left half-way
    with ThreadPoolExecutor(1) as threads, Workers(threads, pieces=0) as executor:
        assert executor is threads


def test_progress_is_told_after_each_item_whoever_works() -> None:
    for executor in (None, Forgetful([-2])):
        told = list[tuple[int, int]]()
        results = results_in_order(
            abs, [-1, -2, -3], executor, lambda done, total, told=told: told.append((done, total))
        )
        assert next(results) == 1
        assert told == [(1, 3)]
        assert list(results) == [2, 3]
        assert told == [(1, 3), (2, 3), (3, 3)]


def test_what_is_lost_is_sent_again_and_what_is_done_is_kept() -> None:
    executor = Forgetful([-2, 5, 5])
    assert list(results_in_order(abs, [-3, 1, -2, 5], executor)) == [3, 1, 2, 5]
    assert executor.sent == [-3, 1, -2, 5, -2, 5, 5]


def test_few_of_many_pieces_are_with_the_executor_at_a_time() -> None:
    executor = Forgetful([-5])
    results = results_in_order(abs, range(-5, 9995), executor)
    assert next(results) == 5
    assert len(executor.sent) < 1000
    assert list(results) == [abs(item) for item in range(-4, 9995)]
    assert sorted(executor.sent) == [-5, *range(-5, 9995)]


def test_work_that_is_lost_again_and_again_is_an_error() -> None:
    with pytest.raises(ComputationError, match=r"ended 3 times at the same work \(OSError: the"):
        list(results_in_order(abs, [1], Forgetful([1, 1, 1])))


@pytest.mark.quick(1)
@pytest.mark.parametrize(("broken", "moment"), [(True, "at once"), (False, "at once"), (False, "half way")])
def test_processes_that_die_are_replaced_and_where_an_executor_breaks_the_rest_is_done_here(
    tmp_path: Path, broken: bool, moment: str
) -> None:
    with Workers(ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) if broken else 2) as executor:
        answers = list(results_in_order(dies_once, [(str(tmp_path), moment, k) for k in range(6)], executor))
        assert answers == [bytes([k] * 1000) for k in range(6)]
        assert list(results_in_order(abs, [-1], executor)) == [1]


def test_work_or_an_answer_that_cannot_be_read_is_an_error_and_waits_for_nothing() -> None:
    """A process that could not read a function does not use the one before."""
    with Workers(2) as executor:
        assert list(results_in_order(Shared(3), range(6), executor)) == [0, 3, 6, 9, 12, 15]
        for function, items in (
            (unreadable, [1, 2, 3]),
            (str, [Unreadable()] * 3),
            (partial(max, Unreadable()), [1, 2, 3]),
        ):
            with pytest.raises(ComputationError, match=r"ended 3 times.*no number"):
                list(results_in_order(function, items, executor))
        assert list(results_in_order(Shared(5), range(6), executor)) == [0, 5, 10, 15, 20, 25]


def test_an_error_in_the_work_reaches_the_caller_and_signals_are_as_before() -> None:
    handler = signal.getsignal(signal.SIGTERM)
    with Workers(2) as executor, pytest.raises(ValueError, match="math domain"):
        list(results_in_order(math.sqrt, [1.0, -1.0], executor))
    assert signal.getsignal(signal.SIGTERM) == handler


@pytest.mark.quick(1)
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_processes_end_with_their_program_and_hold_no_pipe_open(number: signal.Signals, tmp_path: Path) -> None:
    """The pipe reaches its end only when the program and all of its processes are gone."""
    with started(tmp_path) as (program, output):
        program.send_signal(number)
        assert program.wait(BUSY) == -number
        assert ended(output)


@pytest.mark.quick(0)
@pytest.mark.amount(2, 12)
def test_ctrl_c_ends_program_and_processes_at_any_moment(tmp_path: Path, amount: int) -> None:
    """As a terminal sends it, to all of them; at most moments a large result is half-way through a pipe."""
    chance = random.Random(1)
    for _ in range(amount):
        with started(tmp_path, text=ALWAYS_SENDING, group=True) as (program, output):
            time.sleep(chance.uniform(0, 0.7))  # processes start, and then send
            os.killpg(program.pid, signal.SIGINT)
            assert program.wait(BUSY) == 130
            assert ended(output)


def test_what_cannot_be_sent_is_an_error_and_waits_for_nothing() -> None:
    with Workers(2) as executor, pytest.raises(ComputationError, match=r"ended 3 times.*pickle"):
        list(results_in_order(threading.Thread.join, [threading.current_thread()], executor))
    with Workers(2) as executor:
        assert executor is not None
        left = executor.submit(time.sleep, 120.0)
    with pytest.raises(ProcessLookupError, match="were ended"):
        left.result()
    with pytest.raises(RuntimeError, match="have been ended"):
        executor.submit(abs, -1)


@pytest.mark.quick(0)
def test_a_hang_up_that_is_ignored_stays_ignored(tmp_path: Path) -> None:
    with started(tmp_path, "nohup") as (program, output):
        program.send_signal(signal.SIGHUP)
        with pytest.raises(subprocess.TimeoutExpired):
            program.wait(1)
        program.terminate()
        assert program.wait(BUSY) == -signal.SIGTERM
        assert ended(output)


@pytest.mark.quick(0)
def test_each_process_gets_what_the_work_shares_once(monkeypatch):
    monkeypatch.setattr(Shared, "sent", 0)
    with Workers(2) as executor:
        for k, factor in enumerate((3, 5), start=1):
            assert list(results_in_order(Shared(factor), range(50), executor)) == [factor * k for k in range(50)]
            assert Shared.sent == 2 * k
