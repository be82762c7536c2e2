"""Processor time of pieces of work that are run in turns, and memory."""

import argparse
import re
import time
from pathlib import Path

from calib.core.base.threads import one_blas_thread
from calib.core.robots.acceleration import compile_kinematics

QUICK = 0.02
"""Seconds of work that the next one finds its data in the processor's cache after, as the next step of a fit does."""


@one_blas_thread
def least(rounds, **work):
    """Seconds of processor time that each piece of work takes at least, run in turns; quick work thrice each turn."""
    taken = {name: [] for name in work}
    for _ in range(rounds):
        for name, function in work.items():
            for _ in range(3):
                start = time.process_time()
                function()
                taken[name].append(time.process_time() - start)
                if taken[name][-1] > QUICK:
                    break
    return {name: min(times) for name, times in taken.items()}


def fast(function):
    """The same work by compiled kinematics."""

    def run():
        with compile_kinematics():
            return function()

    return run


def peak_memory():
    """Most memory that this program has taken [GB]; `ru_maxrss` may be that of the program which started it."""
    return int(re.search(r"VmHWM:\s+(\d+)", Path("/proc/self/status").read_text())[1]) / 1e6


def print_table(about, table, rounds):
    """Print the lines of a table, for the folder of measurements that the command line may name."""
    parser = argparse.ArgumentParser(description=about.splitlines()[0])
    parser.add_argument("--data", type=Path, help="folder with measurements of others")
    for line in table(parser.parse_args().data, rounds):
        print(line, flush=True)
