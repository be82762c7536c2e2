"""Writing that is ended before each of its lines: is a result ever half of one and half of another?

    python -m tests.core.base.interrupted_writing [--every 5]

It prints what is there after each end, and ends with 1 if that is ever neither the old result nor the new one, or if a
leftover survives the next writing. Processes are forked, so that thousands are cheap.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import FrameType

import calib.core.base.files
import calib.core.base.replacing
from calib.core.base.own_files import MANIFEST, signed

OF_WRITING = {calib.core.base.files.__file__, calib.core.base.replacing.__file__}
OLD = {"result.json": b"old", "parameters.csv": b"old", "calibrated.urdf": b"old"}
NEW = {"result.json": b"new", "parameters.csv": b"new", "report.html": b"new"}
MINE = {"notes/mine.txt": b"mine", "photo.jpg": b"mine"}
WRONG = ("MIXTURE OR LOST", "LEFTOVER", "NOT WRITTEN")
OBSOLETE = ("calibrated.urdf",)


def tree(folder: Path) -> dict[str, bytes]:
    """The files of a folder, and of folders in it."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    named = {str(path.relative_to(folder)): path for path in files}
    return {name: path.read_bytes() for name, path in named.items() if not name.startswith((".calib-", MANIFEST))}


def put(folder: Path, files: dict[str, bytes]) -> None:
    """Write files in the plainest way."""
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


def at_line(number: int, files: set[str], act: Callable[[], None]) -> None:
    """Act before the line of so many that this process runs in these files."""
    left = number

    def trace(frame: FrameType, event: str, _: object) -> Callable[..., object] | None:
        nonlocal left
        if frame.f_code.co_filename not in files:
            return None
        if event == "line":
            left -= 1
            if left == 0:
                act()
        return trace

    sys.settrace(trace)


def killed() -> None:
    """End at once, as a power cut would."""
    os.kill(os.getpid(), signal.SIGKILL)


def interrupted() -> None:
    """What Python does at Ctrl-C."""
    raise KeyboardInterrupt


def child(work: Callable[[], None]) -> int:
    """Fork, work there, and return how that process ended: its exit code, or minus the signal."""
    number = os.fork()
    if number == 0:
        code = 70
        try:
            work()
            code = 0
        except KeyboardInterrupt:
            code = 130
        finally:
            sys.settrace(None)
            os._exit(code)
    return os.waitstatus_to_exitcode(os.waitpid(number, 0)[1])


def state(seen: dict[str, bytes], old: dict[str, bytes], new: dict[str, bytes]) -> str:
    """Say in a word what is there."""
    return "old" if seen == old else "new" if seen == new else "none" if not seen else "MIXTURE"


def steps_of(name: str, act: Callable[[], None], exchange: bool, every: int, first: int) -> Counter[str]:
    """End a piece of writing before one in `every` of its lines from the `first`, and count what is there then."""
    counts: Counter[str] = Counter()
    number = first - every
    while True:
        number += every
        with tempfile.TemporaryDirectory() as here:
            out = Path(here) / "out"
            write, old, new = _piece(name, out)

            def work(number: int = number, write: Callable[[], None] = write) -> None:
                if not exchange:
                    calib.core.base.replacing.exchange = lambda path, other: False
                at_line(number, OF_WRITING, act)
                write()

            code = child(work)
            before = state(tree(out) if out.is_dir() else {}, old, new)
            calib.core.base.replacing.clear_leftovers(out.parent)
            calib.core.base.replacing.clear_leftovers(out)
            after = state(tree(out) if out.is_dir() else {}, old, new)
            if before == "MIXTURE" or (old and after == "none"):
                counts["MIXTURE OR LOST"] += 1
            left = [path.name for path in Path(here).rglob(".calib-*")]
            counts["LEFTOVER"] += bool(left)
            counts[before if before == after else f"{before}, then {after}"] += 1
            if code in (0, 70):  # it was written, or would never be
                counts["NOT WRITTEN"] += after != "new"
                return counts


_PIECES = ("a new folder", "a folder in place of another", "a file")


def _piece(name: str, out: Path) -> tuple[Callable[[], None], dict[str, bytes], dict[str, bytes]]:
    """Prepare a piece of writing; return what writes it, and what is there before and after."""
    if name == "a file":
        old, new = {"a.csv": signed(b"old")}, {"a.csv": signed(b"new")}
        put(out, old)
        return lambda: calib.core.base.files.write_file(out / "a.csv", b"new"), old, new
    old, mine = (OLD, MINE) if "place" in name else ({}, {})
    if old:
        calib.core.base.files.write_folder(out, old)
        put(out, mine)
    return lambda: calib.core.base.files.write_folder(out, NEW, OBSOLETE), old | mine, NEW | mine


def steps(every: int) -> dict[str, Counter[str]]:
    """Kill and interrupt each piece of writing before its lines, with and without an exchange in one step.

    Where not every line is tried, each piece begins with another one.
    """
    counts = {}
    for name in _PIECES:
        for act in (killed, interrupted):
            for exchange in (True, False) if "place" in name else (True,):
                title = f"{name}, {act.__name__}{'' if exchange else ', without an exchange in one step'}"
                counts[title] = steps_of(name, act, exchange, every, 1 + len(counts) % every)
    return counts


def verdict(counts: dict[str, Counter[str]]) -> int:
    """Print counts; return 1 if anything was wrong."""
    print(json.dumps({title: +counted for title, counted in counts.items()}, indent=1))
    return int(any(counted[wrong] for counted in counts.values() for wrong in WRONG))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--every", type=int, default=1, help="one in so many lines (%(default)s)")
    sys.exit(verdict(steps(parser.parse_args().every)))
