"""Write what commands answer to many questions, and compare two checkouts number by number.

For changes that must not change results: run it before, run it after, compare.

    python -m tests.frozen_results FOLDER                      writes the answers of this checkout
    python -m tests.frozen_results FOLDER --against BEFORE     writes them, and compares with those in BEFORE

Everything is simulated, with fixed seeds. Times, paths and versions do not count; numbers may differ by rounding.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

import calib
from tests.core.instruments.test_kind_pixel import INTRINSICS, POINTS
from tests.project import EXAMPLES, ROOT
from tests.six_axis_arm import URDF

SAME = 1e-6
"""Relative difference of numbers that rounding makes."""
NOTHING = 1e-9
"""Numbers below are rounding."""
PASSING = re.compile(r"seconds|version|written_by|path|urdf|file|robot$|folder|settings|evaluations|message")
"""Keys of what may differ between two runs."""
ARM = """\
urdf: arm.urdf
name_mot: [j1, j2, j3, j4, j5, j6]
base: {frame: l0BASE}
targets: {ball: {frame: l6, xyz: [50 mm, 20 mm, 100 mm], position: unknown, sigma: 5 mmTARGET}}
instruments:
  one: {INSTRUMENT}
parametrisation:
  - {origin: all, components: [x, y, z], sigma: 1 mm}
  - {origin: all, components: [rx, ry, rz], sigma: 3 mrad}
"""
UNKNOWN = ", pose: unknown"
TURNED = ", orientation: unknown, sigma_angle: 20 mrad"
KINDS = {
    "position": ("kind: position, target: ball, sigma: 0.03 mm", UNKNOWN, ""),
    "pose": ("kind: pose, target: ball, sigma: 0.03 mm, sigma_angle: 0.1 mrad", UNKNOWN, TURNED),
    "orientation": ("kind: orientation, target: ball, sigma: 0.1 mrad", UNKNOWN, TURNED),
    "distance": (
        "kind: distance, target: ball, end: {frame: l0, xyz: [1, 0, 0], position: unknown}, sigma: 0.02 mm",
        "",
        "",
    ),
    "pixel": (
        f"kind: pixel, target: ball, camera: {{frame: l0}}, intrinsics: {INTRINSICS}, image: [2000, 1600],"
        f" points: {POINTS}, sigma: 0.3",
        "",
        TURNED,
    ),
    "touch": (
        "kind: touch, target: ball, sigma: 0.03 mm, places:"
        " {left: {frame: l0, xyz: [0.7, 0.3, 0.4], position: unknown},"
        " right: {frame: l0, xyz: [0.8, -0.2, 0.5], position: unknown}}",
        "",
        "",
    ),
    "joint_reading": (
        "kind: position, target: ball, sigma: 0.03 mm}\n  two: {kind: joint_reading, joint: j2, zero: unknown,"
        " sigma: 0.1 mrad",
        UNKNOWN,
        "",
    ),
}
"""Instruments, and what is unknown of base and target, by kind of measurement."""


def run(words: str, folder: Path) -> None:
    """Run a command in a folder; exit codes 0 and 3 are answers."""
    command = [sys.executable, "-m", "calib", *words.split(), "--quiet"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    if done.returncode not in (0, 3):
        raise SystemExit(f"calib {words}: exit {done.returncode}\n{done.stdout}{done.stderr}")


def write_answers(folder: Path) -> None:
    """Write all answers into a new folder."""
    folder.mkdir(parents=True)
    for path in [*EXAMPLES.iterdir(), *(ROOT / "urdf").glob("medrue*")]:
        shutil.copy(path, folder)
    (folder / "six").mkdir()
    (folder / "six" / "arm.urdf").write_text(URDF)
    for name in ("medrue", "arm", "five_bar", "stewart", "delta", "3rrr", "four_bar"):
        run(f"fit {name}.yaml {name}_simulated.csv --out {name} --no-pages --validate 0.8", folder)
    run("fit arm.yaml arm_simulated.csv --out arm_auto --no-pages --terms auto --validate 0.8", folder)
    run("fit arm.yaml arm_simulated.csv --out arm_huber --no-pages --loss huber --folds 4", folder)
    for kind, (instrument, base, target) in KINDS.items():
        text = ARM.replace("INSTRUMENT", instrument).replace("BASE", base).replace("TARGET", target)
        robot, data = f"six/{kind}.yaml", f"six/{kind}.csv"
        (folder / robot).write_text(text)
        run(f"sample {robot} --count 60 --seed 1 --out six/{kind}_poses.csv", folder)
        write_truth(folder / robot, folder / "six" / "truth.csv")
        run(f"simulate {robot} six/{kind}_poses.csv --seed 2 --out {data} --parameters six/truth.csv", folder)
        run(f"fit {robot} {data} --out kind_{kind} --no-pages", folder)
        run(f"check {robot} {data} --json kind_{kind}_check.json", folder)
    for words in (
        "check medrue.yaml medrue_simulated.csv --json medrue_check.json",
        "sample arm.yaml --count 200 --seed 3 --out candidates.csv",
        "select arm.yaml candidates.csv --count 15 --index o1 --out select_o1.csv",
        "select arm.yaml candidates.csv --count 15 --index task --out select_task.csv",
        "compensate arm candidates.csv --out compensated.csv --json compensated.json --skip-unreachable",
        "predict arm candidates.csv --out predicted.csv",
        "verify arm arm_simulated.csv --json verified.json",
    ):
        run(words, folder)


def write_truth(robot: Path, path: Path) -> None:
    """Write true values of a robot's parameters: half of what is expected away from nominal, at random."""
    loaded, rng = calib.load(robot), np.random.default_rng(4)
    units = {"length": "m", "angle": "rad"}
    lines = ["parameter,value,unit"]
    for parameter, free in zip(loaded.parameters, loaded.is_free, strict=True):
        off = 0.5 * parameter.sigma_si * rng.standard_normal()
        if free and parameter.dimension in units:
            lines.append(f"{parameter.name},{parameter.nominal_si + off!r},{units[parameter.dimension]}")
    path.write_text("\n".join(lines) + "\n")


def differences(before: Path, after: Path) -> list[str]:
    """Compare the answers in two folders."""
    said = []
    names = {path.relative_to(folder) for folder in (before, after) for path in folder.rglob("*") if path.is_file()}
    for name in sorted(names):
        if name.suffix not in (".json", ".csv") or name.name.startswith("."):
            continue
        if not ((before / name).exists() and (after / name).exists()):
            said.append(f"{name}: only in one of both")
            continue
        said += [f"{name}: {line}" for line in _differ(_content(before / name), _content(after / name), "")]
    return said


def _content(path: Path) -> Any:
    if path.suffix == ".json":
        return json.loads(path.read_text())
    return [line.split(",") for line in path.read_text().splitlines() if not line.startswith("#")]


def _differ(before: Any, after: Any, where: str) -> list[str]:
    if isinstance(before, dict) and isinstance(after, dict):
        keys = [key for key in before.keys() | after.keys() if not PASSING.search(key)]
        both = {key: f"{where}.{key}" for key in keys if key in before and key in after}
        said = [f"{where}.{key}: only in one of both" for key in keys if key not in both]
        return said + [line for key, there in both.items() for line in _differ(before[key], after[key], there)]
    if isinstance(before, list) and isinstance(after, list):
        if len(before) != len(after):
            return [f"{where}: {len(before)} entries, now {len(after)}"]
        pairs = enumerate(zip(before, after, strict=True))
        return [line for k, pair in pairs for line in _differ(*pair, f"{where}[{k}]")]
    if before == after:
        return []
    a, b = _number(before), _number(after)
    if a is None or b is None:
        return [] if _same_sentence(before, after) else [f"{where}: {before!r}, now {after!r}"]
    return [] if math.isclose(a, b, rel_tol=SAME, abs_tol=NOTHING) else [f"{where}: {before}, now {after}"]


def _same_sentence(before: Any, after: Any) -> bool:
    return isinstance(before, str) and isinstance(after, str) and ("/" in before and "/" in after)


def _number(value: Any) -> float | None:
    try:
        return None if isinstance(value, bool) else float(value)
    except (TypeError, ValueError):
        return None


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", metavar="FOLDER", type=Path, help="where to write; must not exist")
    parser.add_argument("--against", metavar="BEFORE", type=Path, help="folder of an earlier run")
    options = parser.parse_args()
    if not options.folder.exists():
        write_answers(options.folder)
    if options.against:
        said = differences(options.against, options.folder)
        print(*said, sep="\n")
        print(f"{len(said)} differences")
        raise SystemExit(bool(said))


if __name__ == "__main__":
    main()
