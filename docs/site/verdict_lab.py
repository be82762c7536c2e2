"""A simulated laboratory: three robots, what measures them, and how a day there is written down."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Literal

import numpy as np
from make_examples import ARM_BASE, EXAMPLES
from numpy.typing import NDArray

import calib
from calib.core.data.in_memory import as_measurements
from calib.core.data.measurements import Measurements
from calib.starting.templates import TEMPLATES
from medrue import robot_file
from medrue.workspace import target_workspace

Array = NDArray[np.float64]
POSES = 80
"""Poses of one calibration, those held out included."""
REACH = 0.05
"""Mean displacement of a target along each axis by a turn of a joint that matters [m per rad]."""
_CLEAR = 0.15  # distance from a singularity of the loops that poses keep
_TARGET = "reflector: {frame: flange, xyz: [20 mm, 0 mm, 50 mm], position: unknown, sigma: 5 mm}"
_TURNED = _TARGET.replace("sigma:", "orientation: unknown, sigma:")
_MARKS = "{a: [0, 0, 0], b: [60 mm, 0, 0], c: [0, 60 mm, 0], d: [0, 0, 60 mm], e: [60 mm, 60 mm, 0]}"
_LENS = "intrinsics: {fx: 2500, fy: 2500, cx: 2000, cy: 1500}, sigma: 0.05"
_BAR = "{kind: distance, target: reflector, sigma: 0.01 mm, end: {frame: base_link, position: "
_KINDS: dict[str, tuple[str, str]] = {
    "base known": (_TARGET, ""),
    "full poses": (_TURNED, "  tracker: {kind: pose, target: reflector, sigma: 0.03 mm, sigma_angle: 0.1 mrad}\n"),
    "distances": (
        _TARGET,
        f"  left: {_BAR}unknown, xyz: [1, 0.8, 0.2]}}}}\n  right: {_BAR}unknown, xyz: [1, -0.9, 0.3]}}}}\n"
        f"  above: {_BAR}unknown, xyz: [0.3, 0.1, 1.6]}}}}\n",
    ),
    "touches": (
        _TARGET,
        "  probe: {kind: touch, target: reflector, artefact: {frame: base_link, xyz: [0.5, 0, 0.3], pose: unknown,"
        " sigma: 5 mm, sigma_angle: 20 mrad, points: {a: [0, 0, 0], b: [200 mm, 0, 0], c: [0, 150 mm, 0]}}}\n",
    ),
    "pixels": (
        _TURNED,
        f"  ahead: {{kind: pixel, target: reflector, camera: {{frame: base_link, xyz: [3, 0, 0.5],"
        f" rpy: [-90 deg, 0, 90 deg]}}, points: {_MARKS}, {_LENS}}}\n"
        f"  aside: {{kind: pixel, target: reflector, camera: {{frame: base_link, xyz: [0.4, -3, 0.5],"
        f" rpy: [-90 deg, 0, 0]}}, points: {_MARKS}, {_LENS}}}\n",
    ),
    "positions and distances": (
        _TARGET,
        "  reflector: {kind: position, sigma: 0.03 mm}\n"
        f"  left: {_BAR}known, xyz: [1, 0.8, 0.2]}}}}\n  right: {_BAR}known, xyz: [1, -0.9, 0.3]}}}}\n",
    ),
}
"""Target and instruments of the arm where it is not positions alone that are measured."""


@dataclass(frozen=True)
class Lab:
    """A laboratory on one day.

    Attributes:
        nominal: The robot as its drawing has it.
        truth: The robot as it is.
        joints: Where it is sent, (n, n_actuated) [m or rad].
        sigma: Noise of one position per axis [m].
        rng: Source of all that is random.
    """

    nominal: calib.Robot
    truth: calib.Robot
    joints: Array
    sigma: float
    rng: np.random.Generator

    def seen(self, joints: Array | None = None, robot: calib.Robot | None = None) -> Array:
        """Return where the targets really are, (n, n_targets, 3) [m]."""
        positions: Array = (robot or self.truth).positions(self.joints if joints is None else joints)
        return positions

    def noise(self, factor: float | Array = 1.0) -> Array:
        """Return normal noise of `factor` times what is stated, (n, n_targets, 3) [m]."""
        shape = (len(self.joints), len(self.nominal.target_names), 3)
        return np.asarray(factor * self.sigma * self.rng.standard_normal(shape))

    def course(self) -> Array:
        """Return when each pose is measured, from 0 to 1, (n, 1, 1)."""
        return np.linspace(0.0, 1.0, len(self.joints))[:, None, None]

    def after(self, part: float) -> Array:
        """Return whether each pose is measured after this part of the time, (n, 1, 1)."""
        return self.course() >= part

    def turns(self) -> Array:
        """Return for each joint a change of all joints that turns this one by 1 rad, zero if it slides, (n, n)."""
        dimensions = self.nominal.mechanism.dimensions
        return np.diag([float(dimensions[name] == "angle") for name in self.nominal.joint_names])

    def any_joint(self) -> int:
        """Return a random joint that turns."""
        return int(self.rng.choice(np.flatnonzero(np.diag(self.turns()))))

    def strong_joints(self) -> Array:
        """Return the joints that turn and move a target by it, in random order."""
        step = 1e-3
        reach = [
            float(np.mean(np.abs(self.seen(self.joints + step * turn) - self.seen()))) / step for turn in self.turns()
        ]
        return np.asarray(self.rng.permutation(np.flatnonzero(np.array(reach) > REACH)))

    def with_joint(self, j: int, values: Array) -> Array:
        """Return the joint values with those of one joint replaced."""
        changed = self.joints.copy()
        changed[:, j] = values
        return changed

    def direction(self) -> Array:
        """Return a random unit vector, (3,)."""
        direction = self.rng.standard_normal(3)
        return np.asarray(direction / np.linalg.norm(direction))

    def written(self, positions: Array, joints: Array | None = None, **more: object) -> Measurements:
        """Return what is handed to `calib fit`.

        Args:
            positions: As read, (n, n_targets, 3) [m].
            joints: As written down; those of the lab if not given.
            more: `names` of the poses; `time` of each [s].
        """
        joints = self.joints if joints is None else joints
        names, time = more.get("names"), more.get("time")
        data = as_measurements(self.nominal, joints, positions, names)  # type: ignore[arg-type]
        return data if time is None else replace(data, context={"time": np.asarray(time, dtype=float)})

    def sent(self, joints: Array) -> Lab:
        """Return the lab with the robot sent elsewhere, (n, n_actuated), as far as its loops close there."""
        return replace(self, joints=joints[self.nominal.close(joints).ok & self.truth.close(joints).ok])

    def good(self) -> Measurements:
        """Return a day on which nothing goes wrong."""
        return self.written(self.seen() + self.noise())


@dataclass(frozen=True)
class Trial:
    """What a fit is given.

    Attributes:
        data: Measurements.
        validation: Others to validate with; None where some of `data` are to be held out.
    """

    data: Measurements
    validation: Measurements | None = None


@dataclass(frozen=True)
class Scenario:
    """One thing that happens to calibrations.

    Attributes:
        kind: `healthy`; `faulty`: something is wrong that a verdict should see; `hidden`: no measurements of the sort
            can show it.
        make: What is measured.
        stated: Whether the noise is stated.
        validate: Part of the poses that is held out; 0 for none.
        robots: On which robots it can happen.
        measured: What is measured of the robot: `positions`, or one of the arm's other kinds.
        settings: Further arguments of `calib.fit`.
        named: What a PASS must say that it does not cover, where that hides it; empty where it cannot know.
    """

    kind: Literal["healthy", "counted", "faulty", "hidden"]
    make: Callable[[Lab], Trial | Measurements]
    stated: bool = True
    validate: float = 0.25
    robots: tuple[str, ...] = ("arm", "MedRUE", "3-RRR")
    measured: str = "positions"
    settings: tuple[tuple[str, object], ...] = ()
    named: str = ""


def open_lab(robot: str, seed: int, measured: str = "positions") -> Lab:
    """Return a laboratory with errors as large as the description expects, or half of that.

    Args:
        robot: Of `ROBOTS`.
        seed: Of everything random.
        measured: As of `Scenario`.
    """
    nominal, rng = _nominal(robot, measured), np.random.default_rng(seed)
    joints = ROBOTS[robot](nominal, rng)
    size = rng.uniform(0.5, 1.0)
    own = nominal.parameters[: nominal.n_origin_parameters]
    values = {
        p.name: p.nominal_si + size * p.sigma_si * rng.normal()
        for p, use in zip(own, nominal.is_free, strict=False)
        if use and not p.placement
    }
    truth = nominal.with_parameters(values | placed(nominal))
    assert nominal.description.sigma is not None
    return Lab(nominal, truth, joints, nominal.description.sigma, rng)


def placed(nominal: calib.Robot) -> dict[str, float]:
    """Return where the base stands, where that is not known."""
    return dict(ARM_BASE) if "base.x" in {p.name for p in nominal.parameters} else {}


@cache
def _nominal(robot: str, measured: str) -> calib.Robot:
    if robot == "MedRUE":
        return calib.load(robot_file())
    folder = Path(mkdtemp(prefix="verdict_"))
    if robot == "3-RRR":
        urdf, text = TEMPLATES["3rrr"].files("robot.urdf")
        text = text.replace("# sigma: 0.04 mm", "sigma: 0.02 mm")
    else:
        urdf, text = ((EXAMPLES / f"arm.{end}").read_text(encoding="utf-8") for end in ("urdf", "yaml"))
        text = text.replace("arm.urdf", "robot.urdf")
        if measured != "positions":
            target, instruments = _KINDS[measured]
            text = text.replace(_TARGET, target + (f"\ninstruments:\n{instruments}" if instruments else ""))
            text = text.replace(", pose: unknown}\ntargets", "}\ntargets") if measured != "full poses" else text
    (folder / "robot.urdf").write_text(urdf, encoding="utf-8")
    (folder / "robot.yaml").write_text(text, encoding="utf-8")
    return calib.load(folder / "robot.yaml")


def _arm_joints(nominal: calib.Robot, rng: np.random.Generator) -> Array:
    low, high = np.radians([[-80, -40, -10, -120, -90, -170], [80, 80, 100, 120, 90, 170]])
    return rng.uniform(low, high, (POSES, 6))


def _medrue_joints(nominal: calib.Robot, rng: np.random.Generator) -> Array:
    q = target_workspace().q
    return np.asarray(q[rng.permutation(len(q))[:POSES]])


def _rrr_joints(nominal: calib.Robot, rng: np.random.Generator) -> Array:
    q = _rrr_workspace()
    return np.asarray(q[rng.permutation(len(q))[:POSES]])


@cache
def _rrr_workspace() -> Array:
    """Poses of the 3-RRR that close and stay clear of singularities: the search takes seconds."""
    nominal = _nominal("3-RRR", "positions")
    q = nominal.home[None] + np.random.default_rng(0).uniform(-0.45, 0.45, (6 * POSES, 3))
    q = q[nominal.close(q).ok]
    return np.asarray(q[nominal.singular_values(nominal.assemble(q)) > _CLEAR])


ROBOTS: dict[str, Callable[[calib.Robot, np.random.Generator], Array]] = {
    "arm": _arm_joints,
    "MedRUE": _medrue_joints,
    "3-RRR": _rrr_joints,
}
"""Joint values to measure at, by robot."""
