"""Gaps of loops in the directions that their closures leave free, which a constraint in 3D has to absorb.

This package closes a loop of a planar mechanism in its plane only. Perpendicular to the plane the bearings hold the
links, and after calibration the two frames of a cut need not meet in that direction. Other programs constrain points
(three directions) or whole frames (six). Such a constraint also acts in the free directions:

* A constant gap does no harm: the constraint is placed at the assembled home, with the gap built into its anchor.
* A gap that changes with the pose has to be absorbed: the simulated links are strained or displaced. `change` is the
  size of this.

The exact alternative is a joint with just the free motions between the first frame and the constraint: a slide for each
free translation, a hinge for a free rotation. Joint and constraint together then equal the closure. For points this is
possible for any free translations; for whole frames if the free motions are those of a joint: slides, one hinge, or a
hinge with slides along or across.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import InputError
from calib.core.base.sections import ANGLE_COMPONENTS, COMPONENTS, Component
from calib.core.base.units import ERROR_UNIT, Dimension, in_unit, quantity_text
from calib.core.robots import kinematics
from calib.core.robots.joint_sampling import joint_samples
from calib.core.robots.robot import Robot

LARGEST_CHANGE = 0.01
"""Largest change of a gap that a constraint may absorb [characteristic lengths of the robot, or rad]."""
_POSES, _REACH = 64, 0.1
_UNLIMITED = {"length": 1.0, "angle": np.pi}  # default limit of a joint without limits [m], [rad]


@dataclass(frozen=True)
class Gap:
    """Distance of the two frames of a closure in one direction that it leaves free.

    Attributes:
        name: Name of the closure.
        direction: Free direction, in the axes of the closure's first frame.
        at_home: Gap in the home configuration [m or rad].
        change: Largest difference from `at_home` over the poses [m or rad].
        n_poses: Number of assembled poses.
        where: Region of these poses, for messages.
    """

    name: str
    direction: Component
    at_home: float
    change: float
    n_poses: int
    where: str

    @property
    def dimension(self) -> Dimension:
        """Dimension of `at_home` and `change`."""
        return "angle" if self.direction in ANGLE_COMPONENTS else "length"

    def text(self) -> str:
        """Return a sentence on the gap, in mm or mrad."""
        apart, change = (
            quantity_text(value, ERROR_UNIT[self.dimension], ".4f") for value in (self.at_home, self.change)
        )
        which = f"loop {self.name}, direction {self.direction}"
        if max(abs(self.at_home), self.change) < 1e-9:
            return f"{which}: stays closed in {self.n_poses} poses{self.where}; a 3D constraint has nothing to absorb"
        return (
            f"{which}: the gap is {apart} at home; a 3D constraint would have to absorb up to {change} over"
            f" {self.n_poses} poses{self.where}"
        )


def poses_near_home(robot: Robot, count: int = _POSES) -> FloatArray:
    """Return assembled poses within a tenth of each joint's range around home, home first, (n, n_actuated) [m or rad].

    `count` poses are tried, evenly spread without random numbers; poses that cannot be assembled are dropped.
    """
    lower, upper = joint_ranges(robot)
    spread = 2 * joint_samples(robot.mode, count + 1)[1:, : len(lower)] - 1  # the first sample is a corner
    around = robot.home + _REACH * (upper - lower) * spread
    inside = np.clip(around, np.minimum(lower, robot.home), np.maximum(upper, robot.home))
    poses = np.vstack([robot.home, inside])
    return poses[robot.close(poses).ok]


def joint_ranges(robot: Robot) -> tuple[FloatArray, FloatArray]:
    """Return lower and upper limits of the actuated joints, (n_actuated,) each [m or rad].

    The default is half a turn or 1 m in both directions.
    """
    default = np.array([_UNLIMITED[robot.mechanism.dimensions[name]] for name in robot.joint_names])
    lower, upper = robot.urdf.limits(robot.joint_names)
    return np.where(np.isfinite(lower), lower, -default), np.where(np.isfinite(upper), upper, default)


def free_directions(robot: Robot, loop: int) -> tuple[Component, ...]:
    """Return the directions that a 3D constraint would hold and the closure leaves free."""
    constrained = robot.mechanism.loops[loop].rows
    whole = range(6 if robot.mechanism.loops[loop].full_pose else 3)
    return tuple(COMPONENTS[row] for row in whole if row not in constrained)


def loop_gaps(robot: Robot) -> tuple[Gap, ...]:
    """Return the gap of every closure in every direction that it leaves free, at poses near home."""
    if not any(free_directions(robot, loop) for loop in range(len(robot.mechanism.loops))):
        return ()
    poses, where = poses_near_home(robot), f" within {100 * _REACH:.0f} % of the joint ranges from home"
    configurations = robot.assemble(np.vstack([robot.home, poses]))
    joints = robot.mechanism.all_joints(configurations.actuated, configurations.passive)
    gaps = []
    for index, loop in enumerate(robot.mechanism.loops):
        whole = replace(loop, rows=tuple(range(6 if loop.full_pose else 3)))
        values = kinematics.value(kinematics.sweep(robot.mechanism, joints, (whole,)), whole)
        for direction in free_directions(robot, index):
            column = values[:, COMPONENTS.index(direction)]
            change = float(np.max(np.abs(column - column[0])))
            gaps.append(Gap(loop.name, direction, float(column[0]), change, len(poses), where))
    return tuple(gaps)


def require_small(robot: Robot, gaps: tuple[Gap, ...]) -> None:
    """Raise `InputError` if a 3D constraint would hold a motion of the mechanism."""
    for gap in gaps:
        limit = LARGEST_CHANGE * (1.0 if gap.dimension == "angle" else robot.mechanism.length)
        if gap.change > limit:
            raise InputError(
                f"{gap.text()}, more than {in_unit(limit, ERROR_UNIT[gap.dimension]):.3g}: the mechanism moves in this"
                " direction; use the variant with free slides (--free-slide)"
            )


def free_joints(robot: Robot, loop: int) -> tuple[Component, ...]:
    """Return the direction of a joint for each free direction of a closure, those of slides first.

    Raises:
        InputError: No chain of joints has exactly these motions.
    """
    free = free_directions(robot, loop)
    slides = [direction for direction in free if direction not in ANGLE_COMPONENTS]
    hinges = [direction for direction in free if direction in ANGLE_COMPONENTS]
    if hinges:
        along = hinges[0][1]
        across = {"x", "y", "z"} - {along}
        if len(hinges) > 1 or (set(slides) - {along}) not in (set(), across):
            raise InputError(
                f"loop {robot.mechanism.loops[loop].name}: its free directions {', '.join(free)} are not"
                " the motions of one joint, and other programs close loops only with joints; constrain other"
                " directions in closed_loop_axes, or split the loop into two closures"
            )
    return (*slides, *hinges)
