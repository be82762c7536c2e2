"""Rates at which usual mistakes in a file are found and named: simulated calibrations of four robots, each with one.

    python docs/site/mistake_rates.py [--every N] [--every-order] [--robots NAMES] [--only WORDS] [--kept FILE] [--page]

Mistakes are columns of joints in another order, rows that are shifted, a joint that is scaled, columns of the
measurement in another order or one of them scaled, another unit, a range that was mapped, rows that were copied, a tool
that sits elsewhere, a target on another link.
--every N tries one in N of them; --every-order takes all orders of the columns of joints, not a choice; --page puts the
table into docs/howto/when_it_fails.md. --kept FILE collects outcomes, so that a run that ended goes on where it was.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import re
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from itertools import permutations, product
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
from make_examples import EXAMPLES
from numpy.typing import NDArray
from verdict_lab import open_lab

import calib
from calib.core.base.errors import CalibrationError
from calib.core.data.in_memory import as_measurements
from calib.core.data.measurements import Measurements
from calib.starting.command import command

Array = NDArray[np.float64]
ROBOTS = ("arm", "five-bar", "UR10e", "MedRUE")
PAGE = EXAMPLES.parent / "howto" / "when_it_fails.md"
POSES = 70
FACTORS = (0.5, 0.7, 0.9, 0.95, 0.97, 1.03, 1.1, 10 / 9, 1.5, 2.0)
UNITS = {"inches": 25.4, "feet": 304.8, "tenths of an inch": 2.54, "cm": 10.0, "m": 1e3, "um": 1e-3}
_PLACE = re.compile(r"(<!-- begin mistakes -->\n).*?(<!-- end mistakes -->)", re.DOTALL)
_HELD_OUT = (0.0, 0.25)
_INTRODUCTION = """\
The table counts the verdicts on simulated files of four robots (the arm above, a five-bar, a UR10e, MedRUE). Each file
has one mistake, and is fitted with `--validate 0.25` and without. *Refused* is an error before any verdict, such as
poses at which the loops cannot close; most of these errors name the mistake, too.
"""


@dataclass(frozen=True)
class Mistake:
    """One mistake.

    Attributes:
        kind: Of which it is one.
        words: What was done.
        make: What the file holds in place of joint values (n, n_actuated) and positions (n, n_targets, 3) [SI].
        named: Pattern of what names it.
    """

    kind: str
    words: str
    make: Callable[[Array, Array], tuple[Array, Array]]
    named: str


@cache
def laboratory(name: str) -> tuple[calib.Robot, calib.Robot, Array, Array]:
    """Return a nominal and the true robot, joint values (n, n_actuated), and readings (n, n_targets, 3)."""
    rng = np.random.default_rng(7)
    if name in ("arm", "MedRUE"):
        lab = open_lab(name, 7)
        return lab.nominal, lab.truth, lab.joints[:POSES], (lab.seen() + lab.noise())[:POSES]
    if name == "five-bar":
        nominal = calib.load(EXAMPLES / "five_bar.yaml")
        q = calib.read_measurements(EXAMPLES / "five_bar_simulated.csv", nominal).joints
    else:
        folder = Path(mkdtemp(prefix="mistakes_"))
        with contextlib.redirect_stdout(io.StringIO()):
            given = [
                "--dh",
                str(EXAMPLES / "ur10e_dh.csv"),
                "--measure",
                "tracker",
                "--out",
                str(folder / "robot.yaml"),
            ]
            command(given, standalone_mode=False)
        nominal = calib.load(folder / "robot.yaml")
        q = rng.uniform(-1.0, 1.0, (POSES, 6)) * np.radians([150, 80, 120, 150, 150, 170])
    own = nominal.parameters[: nominal.n_origin_parameters]
    errors = {
        p.name: p.nominal_si + 0.7 * min(p.sigma_si, 3e-3) * rng.normal()
        for p, use in zip(own, nominal.is_free, strict=False)
        if use
    }
    truth = nominal.with_parameters(errors)
    seen = truth.positions(q)
    return nominal, truth, q, seen + 3e-5 * rng.standard_normal(seen.shape)


def mistakes(name: str, every_order: bool = False) -> Iterator[Mistake]:
    """Yield every mistake in measurements of a robot; of the orders of its joints' columns, a choice or all."""
    nominal, truth, q, points = laboratory(name)
    names, n = nominal.joint_names, q.shape[1]
    turning = np.array([nominal.mechanism.dimensions[joint] == "angle" for joint in names])
    yield from _orders(names, turning, every_order)
    for rows in (-5, -4, -3, -2, -1, 1, 2, 3, 4, 5):
        said = f"{'1 row' if abs(rows) == 1 else f'{abs(rows)} rows'} {'below' if rows > 0 else 'above'}"
        yield Mistake("rows shifted", f"{rows} rows", _shifted(rows), said.replace("1 row ", "(1|one) row "))
    for j, factor in product(range(n), FACTORS):
        yield Mistake(
            "a joint scaled", f"{names[j]} x {factor:.3g}", _scaled(j, factor), rf"\b{names[j]}\b.* (scaled|as far)"
        )
    planar = bool(np.ptp(points[..., 2] - points[..., 2].mean()) < 1e-2)  # of these, a mirrored frame is a turned one
    for order, sign in product(permutations(range(3)), product((1, -1), repeat=3)) if not planar else ():
        even = np.linalg.det(np.eye(3)[list(order)] * sign) > 0
        if (order, sign) != ((0, 1, 2), (1, 1, 1)) and not (even and nominal.description.base.pose == "unknown"):
            words = f"measured {order} {sign}"
            yield Mistake("measured columns", words, _measured(order, sign), "left-handed|measured positions")
    for unit, size in UNITS.items():
        yield Mistake(
            "unit of lengths",
            unit,
            lambda q, p, size=size: (q, p / size),
            f"positions in ({unit}|mm) were read as ({unit}|mm|m)",
        )
    low, high = nominal.urdf.limits(names)
    low, high = (low, high) if np.all(np.isfinite(high - low)) else (q.min(axis=0) - 0.2, q.max(axis=0) + 0.2)
    for ends in ((-100, 100), (0, 4095), (0, 1)):
        mapped = ends[0] + (q - low) / (high - low) * (ends[1] - ends[0])
        as_degrees = np.where(turning, np.radians(mapped), 1e-3 * mapped)
        yield Mistake("a range mapped", str(ends), lambda q, p, to=as_degrees: (to, p), "scaled|range")
    for copies in (0.03, 0.05, 0.15):
        yield Mistake("rows copied", f"{100 * copies:g} %", _copied(copies), "copies")
    section = nominal.description.targets[nominal.target_names[0]]
    if section.position == "known":
        for axis in range(2 if planar else 3):
            yield Mistake("tool elsewhere", f"150 mm along {'xyz'[axis]}", _tool(nominal, axis), "xyz: ")
    for axis, factor in product(range(2 if planar else 3), (0.98, 1.02)):
        scaled = np.where(np.arange(3) == axis, factor, 1.0)
        named = f"measured lengths along {'xyz'[axis]}|joints do not move|scaled"
        yield Mistake("a measured axis scaled", f"{'xyz'[axis]} x {factor}", _measured((0, 1, 2), scaled), named)
    for link, seen in _other_links(truth, q, section.frame):
        yield Mistake("target on another link", link, lambda q, p, seen=seen: (q, seen), "links?\\b|moves? with")


def _orders(names: tuple[str, ...], turning: Array, every: bool) -> Iterator[Mistake]:
    """Columns of joints in another order, numbers as the file has them: all, or a choice among joints that turn."""
    moving = np.arange(len(names)) if every else np.flatnonzero(turning)
    orders = list(permutations(moving))[1:]
    far = np.array([np.sum(order != moving) > 3 for order in orders], dtype=bool)
    if not every:
        some = np.random.default_rng(1).permutation(np.flatnonzero(far))[:20]
        orders = [orders[k] for k in (*np.flatnonzero(~far), *some)]
    unit = np.where(turning, np.radians(1.0), 1e-3)
    for order in orders:
        index = np.arange(len(names))
        index[moving] = order
        moved = [names[k] for k in range(len(names)) if index[k] != k]
        pattern = "columns of .*" + "".join(rf"(?=.*\b{name}\b)" for name in moved)
        yield Mistake("joint columns", f"order {index.tolist()}", _ordered(index, unit), pattern)


def _ordered(index: NDArray[np.int_], unit: Array) -> Callable[[Array, Array], tuple[Array, Array]]:
    """Columns of joints in this order, their numbers in the units of the file."""
    return lambda q, p: ((q / unit)[:, index] * unit, p)


def _shifted(rows: int) -> Callable[[Array, Array], tuple[Array, Array]]:
    """Joint values this many rows below their measurements."""
    return lambda q, p: (q[:-rows], p[rows:]) if rows > 0 else (q[-rows:], p[:rows])


def _scaled(j: int, factor: float) -> Callable[[Array, Array], tuple[Array, Array]]:
    return lambda q, p: (q * np.where(np.arange(q.shape[1]) == j, factor, 1.0), p)


def _measured(order: tuple[int, ...], sign: tuple[int, ...] | Array) -> Callable[[Array, Array], tuple[Array, Array]]:
    return lambda q, p: (q, p[..., list(order)] * np.array(sign))


def _copied(part: float) -> Callable[[Array, Array], tuple[Array, Array]]:
    def make(q: Array, p: Array) -> tuple[Array, Array]:
        some = np.random.default_rng(2).permutation(len(q))[: int(np.ceil(part / (1 - part) * len(q)))]
        rows = np.concatenate([np.arange(len(q)), some])
        return q[rows], p[rows]

    return make


def _tool(nominal: calib.Robot, axis: int) -> Callable[[Array, Array], tuple[Array, Array]]:
    """A target this far from where the description has it."""

    def make(q: Array, p: Array) -> tuple[Array, Array]:
        turned = nominal.forward(q, nominal.description.targets[nominal.target_names[0]].frame)[:, :3, axis]
        return q, p + 0.15 * turned[:, None]

    return make


def _other_links(truth: calib.Robot, q: Array, frame: str) -> Iterator[tuple[str, Array]]:
    """Readings of the target if it sits on each link that moves against its own, (n, n_targets, 3)."""
    rng, own = np.random.default_rng(3), truth.forward(q, frame)
    for link in truth.urdf.links:
        T = truth.forward(q, link)
        if np.ptp(np.linalg.inv(own) @ T, axis=0).max() > 1e-6:
            seen = T[:, :3, 3] + T[:, :3, :3] @ [0.02, 0.03, 0.05]
            each = np.repeat(seen[:, None], len(truth.target_names), axis=1)
            yield link, each + 3e-5 * rng.standard_normal(each.shape)


@dataclass(frozen=True)
class Outcome:
    """Messages about one mistake."""

    robot: str
    kind: str
    words: str
    held_out: float
    grade: str
    named: bool
    text: str


def outcome(robot: str, mistake: Mistake, held_out: float) -> Outcome:
    """Return what is said of one mistake."""
    nominal, _, q, points = laboratory(robot)
    data = as_measurements(nominal, *mistake.make(q, points))
    grade, text = "refused", ""
    try:
        grade, text = _said(nominal, data, held_out)
    except CalibrationError as error:
        text = str(error)
    named = bool(re.search(mistake.named, text, re.DOTALL))
    return Outcome(robot, mistake.kind, mistake.words, held_out, grade, named, text)


def _said(nominal: calib.Robot, data: Measurements, held_out: float) -> tuple[str, str]:
    used, other = data.split(validation=held_out) if held_out else (data, None)
    verdict = calib.fit(nominal, used, validation=other).verdict
    return verdict.grade, "; ".join(r.text for r in verdict.reasons if r.grade == verdict.grade)[:1500]


def table(outcomes: list[Outcome]) -> str:
    """Return the Markdown table: of each kind, how many, how they ended, and how many were named."""
    lines = ["| mistake | tried | PASS | CHECK | FAIL | refused | named correctly |", "|---|" + "---:|" * 6]
    for kind in dict.fromkeys(outcome.kind for outcome in outcomes):
        these = [outcome for outcome in outcomes if outcome.kind == kind]
        grades = Counter(outcome.grade for outcome in these)
        counts = " | ".join(str(grades[grade]) for grade in ("PASS", "CHECK", "FAIL", "refused"))
        named = sum(outcome.named for outcome in these)
        lines.append(f"| {kind} | {len(these)} | {counts} | {100 * named / len(these):.0f} % |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--every-order", action="store_true")
    parser.add_argument("--robots", default=",".join(ROBOTS))
    parser.add_argument("--only", default="")
    parser.add_argument("--kept", type=Path)
    parser.add_argument("--page", action="store_true")
    options = parser.parse_args()
    kept = options.kept.read_text().splitlines() if options.kept and options.kept.exists() else []
    done = {(o.robot, o.kind, o.words, o.held_out): o for o in (Outcome(**json.loads(line)) for line in kept)}
    outcomes = []
    for robot in options.robots.split(","):
        tried = mistakes(robot, options.every_order)
        chosen = [mistake for mistake in tried if options.only in f"{mistake.kind}: {mistake.words}"]
        for mistake, held_out in product(chosen[:: options.every], _HELD_OUT):
            key = (robot, mistake.kind, mistake.words, held_out)
            found = done.get(key) or outcome(robot, mistake, held_out)
            outcomes.append(found)
            if options.kept and key not in done:
                with options.kept.open("a") as file:
                    file.write(json.dumps(found.__dict__) + "\n")
    print(table(outcomes))
    if options.page:
        text = PAGE.read_text(encoding="utf-8")
        part = "" if options.every == 1 else f"One in {options.every} of these mistakes was tried.\n"
        said = f"{_INTRODUCTION}{part}\n{table(outcomes)}"
        PAGE.write_text(_PLACE.sub(lambda place: f"{place[1]}{said}{place[2]}", text), encoding="utf-8")


if __name__ == "__main__":
    main()
