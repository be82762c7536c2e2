"""Work shared over processes: results in order, and processes that end with the program that started them."""

import math
import os
import random
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from calib.errors import ComputationError
from medrue.parallel import Workers

PROGRAM = """
import signal, sys, time
from medrue.parallel import Workers

if __name__ == "__main__":
    signal.signal(signal.SIGHUP, signal.SIG_IGN if "nohup" in sys.argv else signal.SIG_DFL)
    with Workers(2) as workers:
        print(*workers.in_order(abs, [-1, -2]), flush=True)
        list(workers.in_order(time.sleep, [120.0, 120.0, 120.0]))
"""


BUSY = 60.0
"""More seconds than a busy machine needs for anything here; the work takes twice as long."""


@contextmanager
def started(folder: Path, *arguments: str) -> Iterator[tuple[subprocess.Popen[bytes], int]]:
    """The program at work, and the reading end of the pipe that it and its processes write to."""
    script = folder / "program.py"
    script.write_text(PROGRAM)
    reading, writing = os.pipe()
    command = [sys.executable, str(script), *arguments]
    program = subprocess.Popen(command, stdout=writing, stderr=subprocess.DEVNULL, start_new_session=True)
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


def test_results_come_in_the_order_of_the_items() -> None:
    items = [-3, 1, -2, 5]
    with Workers(1) as workers:
        assert list(workers.in_order(abs, items)) == [3, 1, 2, 5]
    with Workers(2) as workers:
        assert list(workers.in_order(abs, items)) == [3, 1, 2, 5]


def test_an_error_in_the_work_reaches_the_caller_and_signals_are_as_before() -> None:
    handler = signal.getsignal(signal.SIGTERM)
    with Workers(2) as workers, pytest.raises(ValueError, match="math domain"):
        list(workers.in_order(math.sqrt, [1.0, -1.0]))
    assert signal.getsignal(signal.SIGTERM) == handler


@pytest.mark.parametrize(
    "number",
    [signal.SIGTERM, signal.SIGHUP, signal.SIGKILL],
)
def test_processes_end_with_their_program_and_hold_no_pipe_open(number: signal.Signals, tmp_path: Path) -> None:
    """The pipe reaches its end only when the program and all of its processes are gone."""
    with started(tmp_path) as (program, output):
        program.send_signal(number)
        assert program.wait(BUSY) == -number
        assert ended(output)


def test_ctrl_c_ends_program_and_processes_at_any_moment(tmp_path: Path) -> None:
    """As a terminal sends it, to all of them; at some moments the results are large and half-way through a pipe."""
    script, chance = tmp_path / "program.py", random.Random(1)
    script.write_text(ALWAYS_SENDING)
    for _ in range(12):
        reading, writing = os.pipe()
        program = subprocess.Popen([sys.executable, str(script)], stdout=writing, start_new_session=True)
        os.close(writing)
        try:
            assert select.select([reading], [], [], BUSY)[0]
            time.sleep(chance.uniform(0, 0.7))  # processes start, and then send
            os.killpg(program.pid, signal.SIGINT)
            assert program.wait(BUSY) == 130
            os.read(reading, 1)
            assert ended(reading)
        finally:
            program.kill()
            program.wait(BUSY)
            os.close(reading)


ALWAYS_SENDING = """
import sys

try:
    from medrue.parallel import Workers

    if __name__ == "__main__":
        print(end="1", flush=True)
        with Workers(2) as workers:
            while True:
                list(workers.in_order(bytes, [300_000] * 20))
except KeyboardInterrupt:
    sys.exit(130)
"""


def test_a_process_that_is_ended_from_outside_is_an_error_in_words() -> None:
    with Workers(2) as workers, pytest.raises(ComputationError, match=r"ended \(exit code 3\).*--jobs 1"):
        list(workers.in_order(os._exit, [3, 3]))


def test_work_that_was_left_half_way_does_not_mix_with_the_next() -> None:
    with Workers(2) as workers:
        assert next(workers.in_order(abs, [-1, -2, -3, -4])) == 1
        assert list(workers.in_order(abs, [-5, -6, -7, -8])) == [5, 6, 7, 8]


def test_a_hang_up_that_is_ignored_stays_ignored(tmp_path: Path) -> None:
    with started(tmp_path, "nohup") as (program, output):
        program.send_signal(signal.SIGHUP)
        with pytest.raises(subprocess.TimeoutExpired):
            program.wait(1)
        program.terminate()
        assert program.wait(BUSY) == -signal.SIGTERM
        assert ended(output)
