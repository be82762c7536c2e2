"""Whole commands that are killed or interrupted at any moment, or run twice at once into one place.

    python -m tests.whole.interrupted_commands [--runs 1000] [--seed 1]

It prints what is there after each of so many runs of `fit`, `compensate`, `export` and `study`, and ends with 1 if that
was ever neither the old result nor the new one, or if a leftover survived the next writing. Processes are forked from
one that has loaded everything and has done the sums and figures of the study, so that a thousand take some minutes.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # a forked process has no threads of its parent

import calib.cli
import calib.core.base.replacing
import medrue
import medrue.cli
import medrue.reports
import medrue.study
from medrue.draws import Work
from tests.core.base.interrupted_writing import OF_WRITING, at_line, child, killed, put, state, tree, verdict
from tests.project import EXAMPLES

_ROBOT, _DATA = str(EXAMPLES / "five_bar.yaml"), str(EXAMPLES / "five_bar_simulated.csv")
_COMMANDS = (
    ("calib", f"fit {_ROBOT} {_DATA} --validate 0.3 --no-pages --seed {{variant}} --out out", "out"),
    ("calib", f"compensate RESULT{{variant}} {_DATA} --out program.csv", "program.csv"),
    ("calib", "export RESULT{variant} --format urdf --out robot.urdf", "robot.urdf"),
    ("medrue", "study --quick --jobs 1 --seed {variant} --out out", "out"),
)
_WAYS = {"killed": 0.5, "killed while it writes": 0.5, "interrupted": 0.2, "two at once": 0.2}
"""How often, as a part of the runs; the first two make up all of them, the others come on top."""
_TIMES = re.compile(rb'("seconds": |degrees of freedom, )[0-9.e-]+|[0-9-]{10} [0-9:]{5} UTC')


def run(group: str, words: str) -> None:
    """Run a program in this process, and end it."""
    null = os.open(os.devnull, os.O_RDWR)
    os.dup2(null, 1)
    os.dup2(null, 2)
    os._exit(called(group, words))


def called(group: str, words: str) -> int:
    """Call a program, and return its exit code."""
    sys.argv = [group, *words.split()]
    try:
        {"calib": calib.cli.main, "medrue": medrue.cli.main}[group]()
    except SystemExit as end:
        return int(end.code or 0)
    return 0


class Command:
    """A command that writes to `out`, in two variants with different results.

    Args:
        group: `calib` or `medrue`.
        words: What comes after the group; `{variant}` is 0 for the old result and 1 for the new one.
        name: Of what is written, in the current folder.
    """

    def __init__(self, group: str, words: str, name: str) -> None:
        self.group, self.words, self.name = group, words, name
        with tempfile.TemporaryDirectory() as here:  # here, so that every forked process has all modules
            os.chdir(here)
            assert called(group, f"{words.format(variant='1')} --quiet") == 0
            os.chdir("/")
        self.old, self.new = self.written("0"), self.written("1")
        assert self.old
        assert {name for name, content in self.old.items() if self.new.get(name) != content}, "the variants are alike"
        began = time.monotonic()
        assert child(lambda: run(self.group, self.words.format(variant="1"))) == 0
        self.seconds = time.monotonic() - began

    def written(self, variant: str) -> dict[str, bytes]:
        """What an undisturbed run writes."""
        with tempfile.TemporaryDirectory() as here:
            os.chdir(here)
            assert child(lambda: run(self.group, self.words.format(variant=variant))) == 0, f"{self.group} {self.words}"
            written = self.seen()
            os.chdir("/")
        return written

    def seen(self) -> dict[str, bytes]:
        """What is there now, but for when it was made and how many seconds it was made."""
        out = Path(self.name)
        files = tree(out) if out.is_dir() else {self.name: out.read_bytes()} if out.exists() else {}
        return {name: _TIMES.sub(rb"\1", content) for name, content in files.items()}

    def put_old(self) -> None:
        """Let the old result be there."""
        put(Path(self.name) if len(self.old) > 1 else Path(), self.old)


def started(work: Callable[[], None]) -> int:
    """Fork, and work there; return the number of the process."""
    number = os.fork()
    if number == 0:
        signal.signal(signal.SIGINT, signal.default_int_handler)  # which the background of a script ignores
        try:
            work()
        finally:
            os._exit(70)
    return number


def disturbed(command: Command, way: str, chance: random.Random) -> tuple[str, int]:
    """Disturb one run of a command; return what is there afterwards, and the exit code."""
    number = chance.randrange(1, 200) if way == "killed while it writes" else 0

    def work() -> None:
        if number:
            at_line(number, OF_WRITING, killed)
        run(command.group, command.words.format(variant="1"))

    process = started(work)
    if way in ("killed", "interrupted"):
        time.sleep(chance.uniform(0, 1.1 * command.seconds))
        os.kill(process, signal.SIGKILL if way == "killed" else signal.SIGINT)
    elif way == "two at once":
        time.sleep(chance.uniform(0, 0.05 * command.seconds))
        other = started(lambda: run(command.group, command.words.format(variant="0")))
        os.waitpid(other, 0)
    code = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
    return state(command.seen(), command.old, command.new), code


def commands(runs: int, seed: int) -> dict[str, Counter[str]]:
    """Disturb whole commands, an old result being there or not, and count what is there afterwards."""
    results = tempfile.mkdtemp()
    os.chdir(results)
    for variant in ("0", "1"):
        words = f"fit {_ROBOT} {_DATA} --seed {variant} --validate 0.3 --out r{variant}"
        assert child(lambda words=words: run("calib", words)) == 0
    robot = calib.load(medrue.robot_file())
    studies = [medrue.study.run_study(robot, medrue.study.QUICK, seed, Work()) for seed in (0, 1)]
    reports = [medrue.reports.study_report(study) for study in studies]
    assert all(report.files() for report in reports)  # and keeps its figures
    medrue.study.run_study = lambda robot, size, seed, work: seed
    medrue.reports.study_report = lambda seed: reports[seed]
    chance = random.Random(seed)
    counts = {}
    for group, words, name in _COMMANDS:
        command = Command(group, words.replace("RESULT", f"{results}/r"), name)
        for way, part in _WAYS.items():
            counted = counts[f"{command.group} {command.words.split()[0]}, {way}"] = Counter()
            for _ in range(round(runs * part / len(_COMMANDS))):
                with tempfile.TemporaryDirectory() as here:
                    os.chdir(here)
                    before = chance.random() < 2 / 3
                    if before:
                        command.put_old()
                    seen, code = disturbed(command, way, chance)
                    counted[f"{seen if seen != 'none' or before else 'none, as before'} (exit {code})"] += 1
                    calib.core.base.replacing.clear_leftovers(Path(here))
                    counted["LEFTOVER"] += bool(list(Path(here).rglob(".calib-*")))
                    counted["MIXTURE OR LOST"] += seen == "MIXTURE" or (before and seen == "none")
                    os.chdir("/")
            print(f"{list(counts)[-1]}: {dict(+counted)}", flush=True)
    return counts


def main() -> int:
    """Try, print what came out, and return 1 if anything was wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    return verdict(commands(options.runs, options.seed))


if __name__ == "__main__":
    sys.exit(main())
