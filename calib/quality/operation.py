"""Operation qualification: the installation reproduces reference results.

References are certified numbers (NIST), products of single transforms, differences of positions, the truth of simulated
robots, and the coverage of 95 % intervals. Other packages add checks of their own robots in the entry point group
`calib.qualification`: functions without arguments that yield `Check`.
"""

from __future__ import annotations

import hashlib
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray
from calib.core.base.registry import list_entry_points, load_entry, load_named
from calib.core.base.units import quantity_text
from calib.core.calibrating.calibrate import calibrate
from calib.core.fitting.fitted import Fit
from calib.core.fitting.settings import Settings
from calib.core.numerics.least_squares import minimise
from calib.core.numerics.observability import information
from calib.core.numerics.prior import Prior
from calib.core.numerics.statistics import find_factors, statistics
from calib.core.robots.robot import Robot
from calib.core.rows.simulate import simulate
from calib.quality.protocol import Check, Phase, Work
from calib.quality.references import PROBLEMS, ReferenceProblem, sample_robots

_PHASE = Phase.OPERATION
_check = partial(Check.from_values, _PHASE)
_DIGITS = 7.0
"""Number of NIST's eleven digits that an answer must have."""
_FAR = 1e-9  # largest difference of positions computed in two ways [m]
_SLOPES = 1e-6  # largest relative difference of derivatives and differences
_QUIET = 1e-7  # stated noise of readings without noise [m]
_FOUND = 1e-6  # allowed error of a robot measured without noise [m]
_POSES, _ELSEWHERE = 40, 25
_SMALL = 0.3  # drawn errors, as part of the expected ones: loops close at nearly the same joint values
_FITS, _LEAST, _MOST = 40, 0.93, 0.97
_INPUTS = (
    ("no such robot", ("fit", "missing.urdf", "missing.csv"), 2),
    ("an unknown option", ("fit", "--no-such-option"), 2),
    ("a description with an unknown key", ("check", "wrong.yaml", "plan.csv"), 2),
    ("a table with a cell that is no number", ("fit", "right.yaml", "wrong.csv"), 2),
    ("a robot and a table that are right", ("sample", "right.yaml", "--count", "3", "--out", "plan.csv", "--quiet"), 0),
)


def operation_work() -> Iterator[Work]:
    """Yield the pieces of work of the phase."""
    for problem in PROBLEMS:
        yield _PHASE, f"regression {problem.name}", lambda problem=problem: _regression(problem)  # type: ignore[misc]
    yield _PHASE, "eight robots", _robots
    yield _PHASE, "coverage of intervals", _coverage
    yield _PHASE, "same numbers twice", _check_repeats
    yield _PHASE, "exit codes", _exit_codes
    for entry in list_entry_points("calib.qualification"):
        yield _PHASE, entry.name, lambda entry=entry: load_named(entry, "check of qualification")()  # type: ignore[misc]


def _regression(problem: ReferenceProblem) -> Iterator[Check]:
    """Solve a problem from both starting points, with the solver and the statistics of every fit."""
    for number, start in enumerate(problem.starts, 1):
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # trial points far away
            found = minimise(
                lambda b: problem.model(b, problem.x)[0] - problem.y,
                lambda b: problem.model(b, problem.x)[1],
                start,
                scaling="jacobian",
                tolerance=1e-15,
                max_evaluations=2000,
            )
        n = len(problem.certified)
        jacobian, group = np.asarray(problem.model(found.x, problem.x)[1]), np.zeros(len(problem.y), dtype=np.intp)
        posterior = information(jacobian)
        span = jacobian @ posterior.root
        factors = find_factors(found.residuals, span, group, 1)
        std = statistics(span, group, posterior, factors, np.ones(n), Prior(np.zeros(n, dtype=bool))).std
        digits = min(_common_digits(found.x, problem.certified), _common_digits(std, problem.std))
        subject = f"regression {problem.name}, start {number}"
        expected = f"certified values and standard deviations to {_DIGITS:g} digits (NIST StRD)"
        yield _check(subject, expected, f"{digits:.1f} digits", bool(digits >= _DIGITS))


def _common_digits(found: FloatArray, certified: FloatArray) -> float:
    """The least number of common digits of two vectors, at most 11."""
    with np.errstate(divide="ignore"):
        return float(np.min(np.minimum(-np.log10(np.abs(found / certified - 1.0)), 11.0)))


def _robots() -> Iterator[Check]:
    """Check positions, loops, derivatives and the recovery of a known truth on eight robots."""
    for number, (name, robot) in enumerate(sample_robots()):
        yield from _robot(name, robot, number)


def _robot(name: str, robot: Robot, seed: int) -> Iterator[Check]:
    true = draw_robot(robot, seed, part=_SMALL)
    joints = _common_poses(robot, true, _POSES, seed)
    apart = _largest_difference(true, joints)
    slopes = _slopes(true, joints[:5])
    off = _recovery_error(robot, true, joints, seed)
    expected = f"within {quantity_text(_FAR, 'mm', 'g')} of a product of single transforms"
    yield _check(f"positions of the {name}", expected, quantity_text(apart, "mm", ".1e"), apart <= _FAR)
    expected = f"relative difference to central differences at most {_SLOPES:g}"
    yield _check(f"Jacobian of the {name}", expected, f"{slopes:.1e}", slopes <= _SLOPES)
    expected = f"readings without noise: within {quantity_text(_FOUND, 'mm', 'g')} of the truth at other poses"
    yield _check(f"recovery of the {name}", expected, quantity_text(off, "mm", ".1e"), off <= _FOUND)


def draw_robot(robot: Robot, seed: int, part: float = 1.0) -> Robot:
    """Return the robot with random errors of its free parameters, with `part` of the expected sigmas."""
    expected = robot.parameters.sigma_si
    draws = np.random.default_rng(seed).standard_normal(len(expected))
    return robot.with_parameters(robot.values + robot.is_free * part * expected * draws)


def _common_poses(robot: Robot, other: Robot, count: int, seed: int) -> FloatArray:
    """Return joint values at which the loops of two robots close, (count, n_actuated) [m or rad]."""
    joints = robot.sample(2 * count, seed=seed)
    return joints[other.close(joints).ok][:count]


def _chain(robot: Robot, joints: FloatArray) -> dict[str, FloatArray]:
    """Each link's pose in the root, (n, 4, 4): products of single transforms of the exported URDF's numbers."""
    configurations = robot.assemble(joints)
    names = (*robot.mechanism.driven, *robot.mechanism.passive)
    values = dict(zip(names, np.hstack([configurations.actuated, configurations.passive]).T, strict=True))
    tree = ElementTree.fromstring(robot.calibrated_urdf())
    waiting, poses = list(tree.iter("joint")), dict[str, FloatArray]()
    while waiting:
        joint = waiting.pop(0)
        parent, child = (_attribute(joint, tag, "link", "") for tag in ("parent", "child"))
        if parent not in poses and any(_attribute(other, "child", "link", "") == parent for other in waiting):
            waiting.append(joint)
            continue
        xyz, rpy, axis = (
            np.array(_attribute(joint, tag, key, default).split(), dtype=float)
            for tag, key, default in (("origin", "xyz", "0 0 0"), ("origin", "rpy", "0 0 0"), ("axis", "xyz", "1 0 0"))
        )
        value = values.get(joint.get("name", ""), np.zeros(len(joints)))[:, None]
        moved, origin = np.tile(np.eye(4), (len(joints), 1, 1)), np.eye(4)
        if joint.get("type") == "prismatic":
            moved[:, :3, 3] = value * axis
        else:
            moved[:, :3, :3] = scipy.spatial.transform.Rotation.from_rotvec(value * axis).as_matrix()
        origin[:3, :3], origin[:3, 3] = scipy.spatial.transform.Rotation.from_euler("xyz", rpy).as_matrix(), xyz
        poses[child] = poses.setdefault(parent, np.tile(np.eye(4), (len(joints), 1, 1))) @ origin @ moved
    return poses


def _attribute(joint: ElementTree.Element, tag: str, key: str, default: str) -> str:
    element = joint.find(tag)
    return default if element is None else element.get(key, default)


def _largest_difference(robot: Robot, joints: FloatArray) -> float:
    """Largest distance of positions and loops from products of single transforms [m]."""
    poses, description = _chain(robot, joints), robot.description
    base = description.base.frame
    tools = {section.frame for section in description.targets.values()}
    seen = np.linalg.inv(robot.forward(joints, base))
    gaps = [(np.linalg.inv(poses[base]) @ poses[tool] - seen @ robot.forward(joints, tool))[:, :3, 3] for tool in tools]
    for index, (first, second) in enumerate(description.closed_loop):
        gap = (np.linalg.inv(poses[first]) @ poses[second])[:, :3, 3]
        gaps.append(gap[:, ["xyz".index(axis) for axis in description.loop_axes(index) if axis in "xyz"]])
    return float(max(np.max(np.abs(gap)) for gap in gaps))


def _slopes(robot: Robot, joints: FloatArray) -> float:
    """Largest difference of the first target's Jacobian from central differences, divided by its largest element."""
    target = next(iter(robot.description.targets.values())).frame
    exact, step = robot.jacobian(joints, target)[:, :3], 1e-6
    for column in range(joints.shape[1]):
        ends = [robot.forward(joints + sign * step * np.eye(joints.shape[1])[column], target) for sign in (1, -1)]
        exact[:, :, column] -= (ends[0] - ends[1])[:, :3, 3] / (2 * step)
    return float(np.max(np.abs(exact)) / np.max(np.abs(robot.jacobian(joints, target)[:, :3])))


def _recovery_error(robot: Robot, true: Robot, joints: FloatArray, seed: int) -> float:
    """Error at other poses of a robot that was calibrated from readings without noise [m]."""
    fit = calibrate(robot, simulate(true, joints, sigma=0.0), None, Settings(sigma=_QUIET))
    elsewhere = _common_poses(fit.robot, true, _ELSEWHERE, seed=seed + 1000)
    return float(np.max(np.linalg.norm(fit.robot.positions(elsewhere) - true.positions(elsewhere), axis=-1)))


def _coverage() -> Iterator[Check]:
    """Count the 95 % intervals that contain the truth, over calibrations of the first arm from simulated readings."""
    _, robot = next(sample_robots())
    hits = list[bool]()
    joints = robot.sample(_POSES, seed=5)
    for seed in range(_FITS):
        true = draw_robot(robot, seed)
        fit = calibrate(robot, simulate(true, joints, seed=seed), None, Settings())
        truth = true.values_by_name
        hits += [
            estimate.low95_si <= truth[name] <= estimate.high95_si
            for name, estimate in fit.parameters.items()
            if estimate.status != "held"
        ]
    share = float(np.mean(hits))
    expected = f"95 % intervals hold the simulated truth in {_LEAST:.0%} to {_MOST:.0%}"
    found = f"{share:.1%} of {len(hits)} intervals"
    yield _check("coverage of intervals", expected, found, _LEAST <= share <= _MOST)


def _check_repeats() -> Iterator[Check]:
    """Calibrate twice from the same readings, and compare every bit of the results."""
    _, robot = next(sample_robots())
    data = simulate(draw_robot(robot, 1), robot.sample(_POSES, seed=1), seed=1)
    digests = [_digest(calibrate(robot, data, None, Settings())) for _ in range(2)]
    found = "the same bits" if digests[0] == digests[1] else "different bits"
    yield _check(
        "same numbers twice", "two fits of the same readings agree in every bit", found, len(set(digests)) == 1
    )


def _digest(fit: Fit) -> str:
    parts = (fit.robot.values, fit.statistics.std, fit.rows.residuals)
    return hashlib.sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in parts)).hexdigest()


def _exit_codes() -> Iterator[Check]:
    """Run the program on wrong and on correct input, as a user does."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        urdf, description = load_entry("calib.methods", "templates")["four_bar"].files("robot.urdf")
        files = {
            "robot.urdf": urdf,
            "right.yaml": description,
            "wrong.yaml": description + "\nno_such_key: 1\n",
            "wrong.csv": "crank [deg],pin_x [mm],pin_y [mm],pin_z [mm]\n10,1,2,many\n",
        }
        for name, text in files.items():
            (place / name).write_text(text, encoding="utf-8")
        for what, arguments, code in _INPUTS:
            command = [sys.executable, "-m", "calib", *arguments]
            done = subprocess.run(command, cwd=place, capture_output=True, text=True)
            lines = done.stderr.strip().splitlines()
            expected = f"exit code {code}" + (", one line on standard error" if code else "")
            found = f"exit code {done.returncode}, {len(lines)} lines on standard error"
            passed = done.returncode == code and len(lines) == bool(code)
            yield _check(f"command line, {what}", expected, found, passed)
