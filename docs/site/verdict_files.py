"""Faults between instrument, controller and file: columns, rows, units, digits, and the wrong robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from verdict_lab import Lab, Scenario, Trial

from calib.core.data.measurements import Measurements


def joint_sign(lab: Lab) -> Measurements:
    """One joint counted the other way."""
    j = lab.any_joint()
    return lab.written(lab.seen() + lab.noise(), lab.with_joint(j, -lab.joints[:, j]))


def joint_zero(lab: Lab) -> Measurements:
    """One joint from a zero that is 90 degrees off."""
    j = lab.any_joint()
    return lab.written(lab.seen() + lab.noise(), lab.with_joint(j, lab.joints[:, j] + np.pi / 2))


def swapped_columns(lab: Lab) -> Measurements:
    """The columns of two neighbouring joints swapped."""
    j = lab.any_joint()
    other = j - 1 if j == lab.joints.shape[1] - 1 else j + 1
    order = np.arange(lab.joints.shape[1])
    order[[j, other]] = other, j
    return lab.written(lab.seen() + lab.noise(), lab.joints[:, order])


def gon(lab: Lab) -> Measurements:
    """One joint in gon instead of degrees."""
    j = lab.any_joint()
    return lab.written(lab.seen() + lab.noise(), lab.with_joint(j, lab.joints[:, j] / 0.9))


def degrees(lab: Lab) -> Measurements:
    """All angles in degrees, in columns that say nothing of units."""
    return lab.written(lab.seen() + lab.noise(), np.where(np.diag(lab.turns()) > 0, np.degrees(lab.joints), lab.joints))


def inches(lab: Lab) -> Measurements:
    """Positions in tenths of an inch, taken for millimetres."""
    return lab.written((lab.seen() + lab.noise()) / 2.54)


def micrometres(lab: Lab) -> Measurements:
    """Positions in mm, taken for m."""
    return lab.written((lab.seen() + lab.noise()) * 1e3)


def mirrored(lab: Lab) -> Measurements:
    """One axis of the tracker with the wrong sign."""
    mirror = np.ones(3)
    mirror[lab.rng.integers(3)] = -1.0
    return lab.written((lab.seen() + lab.noise()) * mirror)


def swapped_axes(lab: Lab) -> Measurements:
    """Two columns of the tracker swapped."""
    return lab.written((lab.seen() + lab.noise())[..., [1, 0, 2]])


def copied_axis(lab: Lab) -> Measurements:
    """One column of the tracker copied over another."""
    return lab.written((lab.seen() + lab.noise())[..., [0, 0, 2]])


def shifted_rows(lab: Lab) -> Measurements:
    """Each reading beside the joints of the pose before."""
    return lab.written(lab.seen() + lab.noise(), np.roll(lab.joints, -1, axis=0))


def lost_row(lab: Lab) -> Measurements:
    """One reading was lost half-way, and those after it moved up."""
    half, positions = len(lab.joints) // 2, lab.seen() + lab.noise()
    return replace(lab, joints=lab.joints[:-1]).written(np.delete(positions, half, axis=0))


def sorted_readings(lab: Lab) -> Measurements:
    """The readings were sorted, the joints not."""
    positions = lab.seen() + lab.noise()
    return lab.written(positions[np.argsort(positions[:, 0, 0])])


def copied_rows(lab: Lab) -> Measurements:
    """A third of the rows pasted a second time."""
    rows = np.r_[: len(lab.joints), : len(lab.joints) // 3]
    return lab.written((lab.seen() + lab.noise())[rows], lab.joints[rows])


def used_twice(lab: Lab) -> Trial:
    """The validation file repeats rows of the first."""
    good = lab.good()
    return Trial(good, good.subset(np.arange(20)))


def zeros(lab: Lab) -> Measurements:
    """The tracker saw nothing at three poses, and its program wrote 0, 0, 0."""
    positions = lab.seen() + lab.noise()
    positions[lab.rng.permutation(len(positions))[:3]] = 0.0
    return lab.written(positions)


def rounded_joints(lab: Lab) -> Measurements:
    """Joint values rounded to 0.1 degrees, or to 0.1 mm."""
    steps = np.where(np.diag(lab.turns()) > 0, np.radians(0.1), 1e-4)
    return lab.written(lab.seen() + lab.noise(), np.round(lab.joints / steps) * steps)


def coarse_readings(lab: Lab) -> Measurements:
    """Readings rounded to 0.2 mm."""
    return lab.written(np.round((lab.seen() + lab.noise()) / 2e-4) * 2e-4)


def lagging_joints(lab: Lab) -> Measurements:
    """Joint values that were logged while the robot still moved: two thousandths of the way are left."""
    steps = np.diff(lab.joints, axis=0, prepend=lab.joints[:1])
    return lab.written(lab.seen() + lab.noise(), lab.joints - 2e-3 * steps)


def typing_errors(lab: Lab) -> Measurements:
    """At four poses one joint value was written down 0.5 degrees off."""
    joints = lab.joints.copy()
    turning = np.flatnonzero(np.diag(lab.turns()))
    for row in lab.rng.permutation(len(joints))[:4]:
        joints[row, lab.rng.choice(turning)] += np.radians(0.5)
    return lab.written(lab.seen() + lab.noise(), joints)


def swapped_targets(lab: Lab) -> Measurements:
    """The tracker took one reflector for the other at a third of the poses."""
    positions = lab.seen() + lab.noise()
    wrong = lab.rng.permutation(len(positions))[: len(positions) // 3]
    positions[wrong] = positions[wrong][:, ::-1]
    return lab.written(positions)


def another_robot(lab: Lab) -> Measurements:
    """The robot has a link that is 30 mm longer than its URDF has."""
    values = dict(zip((p.name for p in lab.truth.parameters), lab.truth.values, strict=True))
    lengths = [p.name for p in lab.nominal.parameters if p.dimension == "length" and not p.placement]
    moved = {}
    for name in lengths:
        change = lab.seen(robot=lab.truth.with_parameters({name: values[name] + 1e-3})) - lab.seen()
        moved[name] = float(np.sqrt(np.mean((change - change.mean(axis=0)) ** 2)))  # what no placement takes up
    name = str(lab.rng.choice([name for name in lengths if moved[name] > max(moved.values()) / 2]))
    longer = lab.truth.with_parameters({name: values[name] + 30e-3})
    return lab.written(lab.seen(robot=longer) + lab.noise())


SPATIAL = ("arm", "MedRUE")
"""Robots whose mirror image is another robot: that of a planar one is the same robot, seen from behind."""
FILES: dict[str, Scenario] = {
    "a joint counted the other way": Scenario("faulty", joint_sign),
    "a joint zero 90 degrees off": Scenario("counted", joint_zero),
    "two joint columns swapped": Scenario("faulty", swapped_columns),
    "a joint in gon instead of degrees": Scenario("faulty", gon),
    "degrees without a unit": Scenario("faulty", degrees),
    "positions in tenths of an inch": Scenario("faulty", inches),
    "positions in mm read as m": Scenario("faulty", micrometres),
    "an axis of the tracker mirrored": Scenario("faulty", mirrored, robots=SPATIAL),
    "two axes of the tracker swapped": Scenario("faulty", swapped_axes, robots=SPATIAL),
    "an axis of the tracker copied over another": Scenario("faulty", copied_axis),
    "readings one row off": Scenario("faulty", shifted_rows),
    "a reading lost half-way": Scenario("faulty", lost_row),
    "readings sorted, joints not": Scenario("faulty", sorted_readings),
    "a third of the rows pasted twice": Scenario("faulty", copied_rows, validate=0.0),
    "validated with rows that were used": Scenario("faulty", used_twice),
    "readings of 0, 0, 0": Scenario("faulty", zeros),
    "joint values rounded to 0.1 deg": Scenario("counted", rounded_joints, stated=False),
    "readings rounded to 0.2 mm": Scenario("counted", coarse_readings),
    "joints logged before they stood still": Scenario("counted", lagging_joints, stated=False),
    "typing errors in four joint values": Scenario("faulty", typing_errors, stated=False),
    "two targets swapped at a third of the poses": Scenario("faulty", swapped_targets, robots=("3-RRR",)),
    "a link 30 mm longer than in the URDF": Scenario("counted", another_robot),
}
"""Sick scenarios of files, by name."""
