"""What a simulated calibration can go through: a table of small functions, healthy ones and sick ones.

A scenario gets a `Lab` and returns the `Sheet` that would be handed to `calib fit`. To add one, write such a function
and name it in `SCENARIOS`; to add a robot, write a function that opens a lab with it and name it in `ROBOTS`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from make_examples import ARM_BASE, EXAMPLES
from numpy.typing import NDArray

import calib
from calib.data.in_memory import as_measurements
from calib.data.measurements import Measurements, directions_of_motion
from medrue import robot_file
from medrue.workspace import target_workspace

Array = NDArray[np.float64]
POSES = 80
"""Poses of one calibration, those held out included."""
_REACH = 0.05  # mean displacement along each axis by a turn of a joint that matters [m per rad]
_ROBOT_FILES = {"arm": EXAMPLES / "arm.yaml", "MedRUE": Path(robot_file())}


@dataclass(frozen=True)
class Lab:
    """A simulated laboratory.

    Attributes:
        nominal: The robot as its drawing has it.
        truth: The robot as it is.
        joints: Where it is sent, (n, n_actuated) [m or rad].
        sigma: Noise of one reading per axis [m].
        rng: Source of all that is random.
    """

    nominal: calib.Robot
    truth: calib.Robot
    joints: Array
    sigma: float
    rng: np.random.Generator

    def seen(self, joints: Array | None = None, robot: calib.Robot | None = None) -> Array:
        """Return where the tracker sees the target, without noise, (n, 3) [m]; as commanded, of the truth."""
        positions: Array = (robot or self.truth).positions(self.joints if joints is None else joints)[:, 0]
        return positions

    def noise(self, factor: float = 1.0) -> Array:
        """Return normal noise of `factor` times what is stated, (n, 3) [m]."""
        return factor * self.sigma * self.rng.standard_normal((len(self.joints), 3))

    def turns(self) -> Array:
        """Return for each joint a change of all joints that turns this one by 1 rad, zero if it slides, (n, n)."""
        dimensions = self.nominal.mechanism.dimensions
        return np.diag([float(dimensions[name] == "angle") for name in self.nominal.joint_names])

    def any_joint(self) -> int:
        """Return a random joint that turns."""
        return int(self.rng.choice(np.flatnonzero(np.diag(self.turns()))))

    def with_joint(self, j: int, values: Array) -> Array:
        """Return the joint values with those of one joint replaced."""
        changed = self.joints.copy()
        changed[:, j] = values
        return changed


@dataclass(frozen=True)
class Sheet:
    """What is written down.

    Attributes:
        joints: (n, n_actuated) [m or rad].
        positions: (n, 3) [m].
        names: Pose names; None where every row is a pose of its own.
    """

    joints: Array
    positions: Array
    names: tuple[str, ...] | None = None

    def measurements(self, robot: calib.Robot) -> Measurements:
        """Return them as the fit reads them."""
        return as_measurements(robot, self.joints, self.positions, self.names)


@dataclass(frozen=True)
class Scenario:
    """One thing that happens to calibrations.

    Attributes:
        kind: Whether something is wrong that a verdict should see.
        make: What is measured.
        stated: Whether the noise is stated.
        validate: Part of the poses that is held out; 0 for none.
    """

    kind: Literal["healthy", "sick"]
    make: Callable[[Lab], Sheet]
    stated: bool = True
    validate: float = 0.25


def open_lab(robot: str, seed: int) -> Lab:
    """Return a laboratory with errors as large as the description expects, or half of that.

    Args:
        robot: Of `ROBOTS`.
        seed: Of everything random.
    """
    nominal, rng = calib.load(_ROBOT_FILES[robot]), np.random.default_rng(seed)
    joints = ROBOTS[robot](rng)
    size = rng.uniform(0.5, 1.0)
    values = {
        p.name: p.nominal + size * p.sigma * rng.normal()
        for p, use in zip(nominal.parameters, nominal.is_free, strict=True)
        if use and not p.placement
    }
    truth = nominal.with_parameters(values | _placed(nominal))
    assert nominal.description.sigma is not None
    return Lab(nominal, truth, joints, nominal.description.sigma, rng)


def _placed(nominal: calib.Robot) -> Mapping[str, float]:
    return ARM_BASE if "base.x" in {p.name for p in nominal.parameters} else {}


def _arm_joints(rng: np.random.Generator) -> Array:
    low, high = np.radians([[-80, -40, -10, -120, -90, -170], [80, 80, 100, 120, 90, 170]])
    return rng.uniform(low, high, (POSES, 6))


def _medrue_joints(rng: np.random.Generator) -> Array:
    q = target_workspace().q
    return np.asarray(q[rng.permutation(len(q))[:POSES]])


ROBOTS: dict[str, Callable[[np.random.Generator], Array]] = {"arm": _arm_joints, "MedRUE": _medrue_joints}
"""Joint values to measure at, by robot."""

# Healthy


def as_expected(lab: Lab) -> Sheet:
    """Errors as the description expects, noise as stated."""
    return Sheet(lab.joints, lab.seen() + lab.noise())


def as_drawn(lab: Lab) -> Sheet:
    """A robot without errors."""
    robot = lab.nominal.with_parameters(dict(_placed(lab.nominal)))
    return Sheet(lab.joints, lab.seen(robot=robot) + lab.noise())


def repeated(lab: Lab) -> Sheet:
    """Each pose read three times, approached anew: joints and readings differ."""
    q = np.repeat(lab.joints, 3, axis=0) + lab.rng.uniform(-2e-4, 2e-4, (3 * len(lab.joints), lab.joints.shape[1]))
    positions = lab.seen(q) + lab.sigma * lab.rng.standard_normal((len(q), 3))
    return Sheet(q, positions, tuple(str(k // 3) for k in range(len(q))))


# Wrong columns, rows and units


def joint_sign(lab: Lab) -> Sheet:
    """One joint counted the other way."""
    j = lab.any_joint()
    return Sheet(lab.with_joint(j, -lab.joints[:, j]), lab.seen() + lab.noise())


def swapped_columns(lab: Lab) -> Sheet:
    """The columns of two neighbouring joints swapped."""
    j = lab.any_joint()
    other = j - 1 if j == lab.joints.shape[1] - 1 else j + 1
    order = np.arange(lab.joints.shape[1])
    order[[j, other]] = other, j
    return Sheet(lab.joints[:, order], lab.seen() + lab.noise())


def wrong_unit(lab: Lab) -> Sheet:
    """One joint in gon instead of degrees."""
    j = lab.any_joint()
    return Sheet(lab.with_joint(j, lab.joints[:, j] / 0.9), lab.seen() + lab.noise())


def mirrored(lab: Lab) -> Sheet:
    """One axis of the tracker with the wrong sign."""
    mirror = np.ones(3)
    mirror[lab.rng.integers(3)] = -1.0
    return Sheet(lab.joints, (lab.seen() + lab.noise()) * mirror)


def shifted_rows(lab: Lab) -> Sheet:
    """Each reading beside the joints of the pose before."""
    return Sheet(np.roll(lab.joints, -1, axis=0), lab.seen() + lab.noise())


# Wrong readings


def outliers(lab: Lab) -> Sheet:
    """One reading in twenty off by 1 mm or so."""
    positions = lab.seen() + lab.noise()
    bad = lab.rng.permutation(len(positions))[: len(positions) // 20]
    positions[bad] += lab.rng.normal(0.0, 1e-3, (len(bad), 3))
    return Sheet(lab.joints, positions)


def noisy(lab: Lab) -> Sheet:
    """Ten times the noise that was stated."""
    return Sheet(lab.joints, lab.seen() + lab.noise(10.0))


def drift(lab: Lab) -> Sheet:
    """The tracker drifts by ten times its noise in the course of the measurement."""
    course = np.linspace(0.0, 1.0, len(lab.joints))[:, None]
    return Sheet(lab.joints, lab.seen() + lab.noise() + 10 * lab.sigma * course * _direction(lab))


def tracker_moved(lab: Lab) -> Sheet:
    """The tracker is pushed by 1 mm after half of the poses."""
    late = (np.arange(len(lab.joints)) >= len(lab.joints) // 2)[:, None]
    return Sheet(lab.joints, lab.seen() + lab.noise() + 1e-3 * late * _direction(lab))


def copied(lab: Lab) -> Sheet:
    """A third of the rows pasted a second time."""
    first = as_expected(lab)
    rows = np.r_[: len(first.joints), : len(first.joints) // 3]
    return Sheet(first.joints[rows], first.positions[rows])


# What the model leaves out


def backlash(lab: Lab) -> Sheet:
    """A backlash of 0.1 degrees in one joint."""
    return _joint_error(lab, lambda q, way: np.radians(0.05) * way)


def compliance(lab: Lab) -> Sheet:
    """A joint that sags by up to 0.1 degrees with its angle, as under its own weight."""
    return _joint_error(lab, lambda q, way: np.radians(0.1) * np.cos(2.0 * q))


def eccentric_encoder(lab: Lab) -> Sheet:
    """An encoder off its centre: three waves in a turn, 0.05 degrees high."""
    return _joint_error(lab, lambda q, way: np.radians(0.05) * np.sin(3.0 * q))


def slipped_encoder(lab: Lab) -> Sheet:
    """An encoder that slips by 0.1 degrees after two thirds of the poses."""
    late = np.arange(len(lab.joints)) >= 2 * len(lab.joints) // 3
    return _joint_error(lab, lambda q, way: np.radians(0.1) * late)


# Wrong poses


def one_corner(lab: Lab) -> Sheet:
    """All poses within two degrees (and 2 mm) of each other."""
    q = lab.joints[0] + 0.03 * (lab.joints - lab.joints[0])
    return Sheet(q, lab.seen(q) + lab.noise())


def too_few(lab: Lab) -> Sheet:
    """A dozen poses or so."""
    sheet = as_expected(lab)
    return Sheet(sheet.joints[:16], sheet.positions[:16])


def _direction(lab: Lab) -> Array:
    direction = lab.rng.standard_normal(3)
    return direction / np.linalg.norm(direction)


def _joint_error(lab: Lab, error: Callable[[Array, Array], Array]) -> Sheet:
    """One joint is off by error(its values, its direction of approach) [rad]: one that moves the target by it."""
    step = 1e-3
    reach = [float(np.mean(np.abs(lab.seen(lab.joints + step * turn) - lab.seen()))) / step for turn in lab.turns()]
    j = int(lab.rng.choice(np.flatnonzero(np.array(reach) > _REACH)))
    off = error(lab.joints[:, j], directions_of_motion(lab.joints)[:, j])
    return Sheet(lab.joints, lab.seen(lab.with_joint(j, lab.joints[:, j] + off)) + lab.noise())


SCENARIOS: dict[str, Scenario] = {
    "errors as expected": Scenario("healthy", as_expected),
    "errors as expected, nothing held out": Scenario("healthy", as_expected, validate=0.0),
    "errors as expected, noise not stated": Scenario("healthy", as_expected, stated=False),
    "no errors: robot as drawn": Scenario("healthy", as_drawn),
    "each pose read three times": Scenario("healthy", repeated),
    "a joint counted the other way": Scenario("sick", joint_sign),
    "two joint columns swapped": Scenario("sick", swapped_columns),
    "a joint in gon instead of degrees": Scenario("sick", wrong_unit),
    "an axis of the tracker mirrored": Scenario("sick", mirrored),
    "readings one row off": Scenario("sick", shifted_rows),
    "5 % outliers": Scenario("sick", outliers),
    "noise ten times what was stated": Scenario("sick", noisy),
    "the tracker drifts": Scenario("sick", drift),
    "the tracker is moved half-way": Scenario("sick", tracker_moved),
    "a third of the rows pasted twice": Scenario("sick", copied, validate=0.0),
    "backlash of one joint": Scenario("sick", backlash),
    "a joint that sags": Scenario("sick", compliance),
    "an encoder off its centre": Scenario("sick", eccentric_encoder),
    "an encoder that slips": Scenario("sick", slipped_encoder),
    "all poses in one corner": Scenario("sick", one_corner),
    "too few poses": Scenario("sick", too_few, validate=0.0),
}
"""What is tried, by its name."""
