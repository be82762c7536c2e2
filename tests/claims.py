"""What fits claim of real robots, and what poses show that they have not seen.

    python -m tests.claims FOLDER [--terms auto] [--only WORDS] [--page]

It prints a line for each fit, then a table of each sort of split.

FOLDER holds measurements by others, as `tests/public_data.py` reads them. Each fit gets the first part of a split, and
is judged with the second. --page writes the table into docs/verdict.md.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np

import calib
from calib.core.base.errors import CalibrationError
from calib.core.base.words import count_noun
from calib.core.data.measurements import Measurements
from calib.core.judging.claim import claim_of, is_elsewhere, unlike_measured
from tests.project import EXAMPLES
from tests.public_data import PLACES, described, motoman, mukca, of_folder, ur10_tracker, written
from tests.six_axis_arm import FREE

PAGE = EXAMPLES.parent / "verdict.md"
POINTS = ("cam", "cx", "cy", "cz")


@dataclass(frozen=True)
class Split:
    """Poses to fit, and poses to judge."""

    robot: str
    how: str
    nominal: calib.Robot
    used: Measurements
    unused: Measurements


def splits(folder: Path) -> Iterator[Split]:
    """Yield every split."""
    yield from _ur10(folder)
    yield from _motoman(folder)
    for points in (0, 1, 4):
        robot, data = fr3(folder, points)
        order = np.random.default_rng(points).permutation(len(data))
        kind = "poses" if points == 0 else f"poses as {count_noun(points, 'point')}"
        yield Split("FR3", f"{kind}, 60 at random", robot, *_parts(data, order[:60], order[60:]))
    yield from _positioner(folder)
    for arm, places in PLACES.items():
        if (folder / "mukca").is_dir():
            yield from _sockets(folder, arm, places)


def _parts(data: Measurements, *rows: np.ndarray) -> Iterator[Measurements]:
    return (data[np.sort(part)] for part in rows)


def _ur10(folder: Path) -> Iterator[Split]:
    rng = np.random.default_rng(7)
    for full in (False, True):
        robot, data, use = ur10_tracker(folder / "ur10_tracker", full)
        test = np.sort(rng.permutation(np.flatnonzero(use == "test"))[:300])
        pool, n, kind = np.flatnonzero(use != "test"), len(data), ", full poses" if full else ""
        for count in (100, 300) if full else (50, 50, 100, 100, 200, 200, 300, 300):
            drawn = rng.permutation(pool)[:count]
            yield Split("UR10", f"{count} at random{kind}", robot, *_parts(data, drawn, test))
        if full:
            continue
        quarters = np.array_split(np.arange(n), 4)
        for a, b in ((0, 1), (1, 2), (2, 3), (3, 0)):
            drawn = [rng.permutation(quarters[k])[:300] for k in (a, b)]
            how = f"300 of quarter {a + 1} of the file, judged by quarter {b + 1}"
            yield Split("UR10", how, robot, *_parts(data, *drawn))
        for a in (3, 17, 30):
            rows = [np.arange(k * n // 40, k * n // 40 + 300) for k in (a, a + 5)]
            how = f"300 in a row, {a}/40 through the file, judged by 300 later ones"
            yield Split("UR10", how, robot, *_parts(data, *rows))
        yield from _halves("UR10", robot, data, 200, rng)


def _halves(name: str, robot: calib.Robot, data: Measurements, most: int, rng: np.random.Generator) -> Iterator[Split]:
    for j, joint in enumerate(robot.joint_names):
        values = data.joints[:, j]
        if np.ptp(values) > 1e-3:
            low, high = (np.flatnonzero(side) for side in (values < np.median(values), values >= np.median(values)))
            drawn = rng.permutation(low)[:most], rng.permutation(high)[:300]
            yield Split(name, f"low half of {joint}, judged by the high half", robot, *_parts(data, *drawn))


def _motoman(folder: Path) -> Iterator[Split]:
    robot, train, test = motoman(folder / "motoman_right")
    rng = np.random.default_rng(7)
    yield Split("Motoman", "training file, judged by the test file", robot, train, test)
    for count in (50, 50, 80, 80, 120, 120):
        order = rng.permutation(len(train))
        yield Split("Motoman", f"{count} at random", robot, *_parts(train, order[:count], order[count:]))
    yield from _halves("Motoman", robot, train, 200, rng)
    half = len(train) // 2
    rows = np.arange(half), np.arange(half, len(train))
    yield Split("Motoman", "first half of the file, judged by the second", robot, *_parts(train, *rows))


def _sockets(folder: Path, arm: str, places: object) -> Iterator[Split]:
    robot, data = mukca(folder / "mukca", arm, places, None)
    rng, setups = np.random.default_rng(7), cast(np.ndarray, data.setups)
    order, count = rng.permutation(len(data)), 3 * len(data) // 4
    yield Split(arm, "three quarters at random", robot, *_parts(data, order[:count], order[count:]))
    for setup in np.unique(setups):
        there, others = np.flatnonzero(setups == setup), np.flatnonzero(setups != setup)
        yield Split(arm, f"without place {setup + 1}, judged there", robot, *_parts(data, others, there))
        yield Split(arm, f"place {setup + 1} alone, judged by the others", robot, *_parts(data, there, others))


def positioner(folder: Path) -> tuple[calib.Robot, Measurements]:
    """Return a table with two axes, and what a camera system measured of it."""
    where = folder / "positioner"
    text = "urdf: robot.urdf\nname_mot: [j1, j2]\nbase: {frame: world, pose: unknown}\n"
    text += f"targets: {{target: {{frame: table, position: unknown}}}}\nparametrisation:\n{FREE}"
    robot = described(where / "robot.urdf", text)
    return robot, calib.read_measurements(where / "positions.csv", robot)


def _positioner(folder: Path) -> Iterator[Split]:
    robot, data = positioner(folder)
    rng, half = np.random.default_rng(7), len(data) // 2
    for count in (50, 50, 100, 100, 150):
        order = rng.permutation(len(data))
        yield Split("positioner", f"{count} at random", robot, *_parts(data, order[:count], order[count:]))
    rows = np.arange(half), np.arange(half, len(data))
    yield Split("positioner", "first half of the file, judged by the second", robot, *_parts(data, *rows))
    yield Split("positioner", "second half of the file, judged by the first", robot, *_parts(data, *rows[::-1]))


def fr3(folder: Path, points: int) -> tuple[calib.Robot, Measurements]:
    """Return a Franka FR3 read by a camera: full poses, or so many points of each pose."""
    where, joints = folder / "fr3_camera_poses", ", ".join(f"panda_joint{k}" for k in range(1, 8))
    text = f"urdf: robot.urdf\nname_mot: [{joints}]\nbase: {{frame: panda_link0, pose: unknown}}\ntargets:\n"
    place = f"{{frame: panda_link8, position: unknown{'' if points else ', orientation: unknown'}}}"
    text += "".join(f"  {name}: {place}\n" for name in POINTS[: max(points, 1)])
    text += "" if points else "instruments: {cam: {kind: pose, rotation: matrix}}\n"
    robot = described(where / "robot.urdf", f"{text}parametrisation:\n{FREE}")
    return robot, calib.read_measurements(where / ("train.csv" if points == 0 else "four_points_train.csv"), robot)


_SORTS = (
    (r"^\d+ at random(?:, full poses)?$", "at random"),
    (r"^poses.*, 60 at random$", "at random, poses or points"),
    (r"quarter \d of the file, judged by quarter \d", "a quarter of the file, judged by the next"),
    (r"in a row, \d+/40 through the file, judged by", "in a row, judged by"),
    (r"low half of \S+,", "low half of one joint,"),
    (r"place \d", "one place"),
    (r"(first|second) half of the file, judged by the \w+", "half of the file, judged by the other"),
)


def table_of_sorts(lines: list[list[str]]) -> str:
    """Return a Markdown table with a line for each robot and sort of split, from the cells of all fits."""
    groups: dict[tuple[str, str], list[list[str]]] = {}
    for robot, how, *cells in lines:
        sort = how
        for pattern, words in _SORTS:
            sort = re.sub(pattern, words, sort)
        groups.setdefault((robot, sort), []).append(cells)
    text = ["| robot | poses used; judged by | fits | unlike [%] | error / claim | PASS | CHECK | FAIL |"]
    text.append("|---|---|---:|---:|---:|---:|---:|---:|")
    for (robot, sort), rows in groups.items():
        unlike, ratios = ([float(row[k]) for row in rows] for k in (0, 4))
        grades = " | ".join(str(sum(row[5] == grade for row in rows)) for grade in ("PASS", "CHECK", "FAIL"))
        ends = f"{min(ratios):.2f} to {max(ratios):.2f}" if len(rows) > 1 else f"{ratios[0]:.2f}"
        far = f"{min(unlike):.0f} to {max(unlike):.0f}" if min(unlike) < max(unlike) else f"{unlike[0]:.0f}"
        text.append(f"| {robot} | {sort} | {len(rows)} | {far} | {ends} | {grades} |")
    return "\n".join(text)


def _within(ratios: np.ndarray) -> str:
    return f"{np.sum((ratios >= 0.75) & (ratios <= 1.33))} of {len(ratios)}"


def main() -> None:
    """Run the command line."""
    parser = of_folder(__doc__, PAGE)
    parser.add_argument("--terms", default=None)
    options = parser.parse_args()
    lines: list[str] = []
    right, n_splits, ratios, there, alike = [0, 0], [0, 0], [], [], []
    for split in splits(options.folder):
        if options.only not in f"{split.robot} {split.how}":
            continue
        try:
            fit = calib.fit(split.nominal, split.used, validation=split.unused, terms=options.terms)
        except CalibrationError as error:
            print(f"{split.robot}, {split.how}: refused: {error}", flush=True)
            continue
        made = claim_of(fit)
        before, after = (1e3 * fit.validation.rms(state) for state in ("before", "after"))
        told = 1e3 * made.at_measured_poses.rms if made else float("nan")
        good = after <= 1.25 * told and after < before
        n_splits[good] += 1
        right[good] += (fit.verdict.grade == "PASS") == good
        ratios.append(after / told)
        unlike = unlike_measured(fit)
        alike.append(not is_elsewhere(unlike))
        if made and made.at_measured_poses.is_position:
            known = float(np.sqrt(np.mean(fit.validation_uncertainty.reported_distance**2)))
            there.append(after / (1e3 * made.error_at(known).rms))
        codes = [reason.code for reason in fit.verdict.reasons if reason.grade != "PASS"]
        first = codes[0].replace("_", "\\_") if codes else ""
        numbers = f"{100 * np.mean(unlike):.0f} | {before:.3f} | {after:.3f} | {told:.3f} | {after / told:.2f}"
        lines.append(f"| {split.robot} | {split.how} | {numbers} | {fit.verdict.grade} | {first} |")
        print(lines[-1], flush=True)
    seen = np.array(ratios)
    words = (
        f"Of {n_splits[True]} fits whose error is at most 1.25 times the claimed one and smaller than before,"
        f" {right[True]} are PASS. Of the {n_splits[False]} others, {right[False]} are CHECK or FAIL. The error of"
        f" poses that were not used is {np.median(seen):.2f} times the claimed one (median). This ratio is 0.75 to 1.33"
        f" in {_within(seen[alike])} fits whose validation poses are like those measured, which the claim is about, and"
        f" in {_within(seen)} fits in all. `claim_at` expects the error of positions at the validation poses: the ratio"
        f" to it is 0.75 to 1.33 in {_within(np.array(there))} fits."
    )
    print(words)
    if options.page:
        cells = [[cell.strip() for cell in line.strip("| ").split("|")] for line in lines]
        written(PAGE, "real robots", "\n".join([table_of_sorts(cells), "", *textwrap.wrap(words, 120)]))


if __name__ == "__main__":
    main()
