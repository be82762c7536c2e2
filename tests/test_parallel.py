"""Work shared over processes: results in order, and processes that end with the program that started them."""

import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from medrue.parallel import Workers

PROGRAM = """
import sys, time
from medrue.parallel import Workers

if __name__ == "__main__":
    with Workers(2) as workers:
        print(*workers.in_order(abs, [-1, -2]), flush=True)
        list(workers.in_order(time.sleep, [120.0, 120.0, 120.0]))
"""


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
    ("number", "code"),
    [(signal.SIGTERM, 143), (signal.SIGHUP, 129), (signal.SIGINT, -signal.SIGINT), (signal.SIGKILL, -signal.SIGKILL)],
)
def test_processes_end_with_their_program_and_hold_no_pipe_open(
    number: signal.Signals, code: int, tmp_path: Path
) -> None:
    """The pipe reaches its end only when the program and all of its processes are gone."""
    script = tmp_path / "program.py"
    script.write_text(PROGRAM)
    reading, writing = os.pipe()
    program = subprocess.Popen([sys.executable, str(script)], stdout=writing, stderr=subprocess.DEVNULL)
    os.close(writing)
    with os.fdopen(reading, "rb") as output:
        assert output.readline() == b"1 2\n"
        started = time.monotonic()
        program.send_signal(number)
        assert output.read() == b""
        # 120 s of work were under way; half of that is far more than even a busy machine needs to stop
        assert time.monotonic() - started < 60
    assert program.wait(60) == code
