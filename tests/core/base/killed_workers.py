"""Programs of which one worker process is killed at any moment: does the program end, and with every result?

    python -m tests.core.base.killed_workers [--runs 60] [--seed 1] [--within 30]

Each program shares work over two processes, whose results of 300 kB are nearly always half-way through a pipe, and goes
on once more after the loss. It prints how many programs ended with all results (complete), were ended by force after so
many seconds (hung), or ended otherwise (lost), and ends with 1 if any did not complete.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import random
import select
import signal
import subprocess
import sys
import time
from collections import Counter
from contextlib import suppress

from calib.core.base.workers import Workers, results_in_order
from tests.project import ROOT

_SIZE, _PIECES = 300_000, 40
_START = 60.0
"""Seconds that a program has for its processes to work."""
_MOMENTS = 0.5
"""Seconds in which the moment of killing is drawn."""


def result_of(number: int) -> bytes:
    """What a worker sends."""
    return bytes([number]) * _SIZE


def program() -> None:
    """Share work until standard input ends, then once more; print the processes that work, and when all was right."""
    with Workers(2) as executor:
        last, workers = False, ""
        while not last:
            last = bool(select.select([sys.stdin], [], [], 0)[0])
            for number, result in enumerate(results_in_order(result_of, range(_PIECES), executor)):
                if result != result_of(number):
                    sys.exit(f"result {number} is wrong")
                if not workers:
                    workers = " ".join(str(process.pid) for process in multiprocessing.active_children())
                    print(workers, flush=True)
    print("complete", flush=True)


def outcome(chance: random.Random, within: float) -> str:
    """Run a program, kill one of its workers, and return how it ended; whatever it did, nothing of it is left."""
    pipe = subprocess.PIPE
    arguments = [sys.executable, "-m", "tests.core.base.killed_workers", "--program"]
    started = subprocess.Popen(
        arguments, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL, start_new_session=True, cwd=ROOT
    )
    assert started.stdin
    assert started.stdout
    try:
        ready = select.select([started.stdout], [], [], _START)[0]
        workers = sorted(map(int, started.stdout.readline().split())) if ready else []
        if len(workers) != 2:
            return "did not start"
        time.sleep(chance.uniform(0, _MOMENTS))
        os.kill(chance.choice(workers), signal.SIGKILL)
        said, _ = started.communicate(timeout=within)  # which closes its standard input
        return "complete" if started.returncode == 0 and said.endswith(b"complete\n") else "lost"
    except subprocess.TimeoutExpired:
        return "hung"
    finally:
        with suppress(ProcessLookupError):  # all of them are gone
            os.killpg(started.pid, signal.SIGKILL)
        started.communicate()


def main() -> int:
    """Try, print what came out, and return 1 if anything was wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--within", type=float, default=30.0, help="seconds after which a program counts as hung")
    parser.add_argument("--program", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.program:
        program()
        return 0
    chance = random.Random(options.seed)
    outcomes = Counter(outcome(chance, options.within) for _ in range(options.runs))
    print(f"{options.runs} programs, seed {options.seed}: {dict(outcomes)}")
    return int(outcomes["complete"] < options.runs)


if __name__ == "__main__":
    sys.exit(main())
