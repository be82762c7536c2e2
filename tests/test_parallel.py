"""Work shared over processes: results in order, and processes that end with the program that started them."""

import math
import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

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
    program = subprocess.Popen([sys.executable, str(script), *arguments], stdout=writing, stderr=subprocess.DEVNULL)
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


def test_a_hang_up_that_is_ignored_stays_ignored(tmp_path: Path) -> None:
    with started(tmp_path, "nohup") as (program, output):
        program.send_signal(signal.SIGHUP)
        with pytest.raises(subprocess.TimeoutExpired):
            program.wait(1)
        program.terminate()
        assert program.wait(BUSY) == -signal.SIGTERM
        assert ended(output)
