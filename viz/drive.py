"""What a page needs to move a robot by hand: which values its motors give, and what closes its loops.

The page follows the loops itself, from a pose in which they are closed, in small steps of the motors with Newton's
method at each (`templates/drive.js`, the same equations as `calib.model.loops`). It stops where a loop does not close,
a passive joint meets its limit, or the next step would pass a singularity, behind which another assembly mode begins.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from calib import Robot
from calib.arrays import FloatArray
from calib.model.mechanism import RelativeFrame
from viz.bodies import Bodies


@dataclass(frozen=True, eq=False)
class Drive:
    """How all joints follow from the motors. Values of moving joints stand in the order of `PosedRobot.values`.

    Attributes:
        by_actuated, by_passive, constant: Values of moving joints are the first times motors, plus the second times
            passive joints, plus the last: (n_moving, n_actuated), (n_moving, n_passive), (n_moving,).
        columns: Where each passive joint itself stands among moving joints, (n_passive,).
        loops: Closures; their frames are bodies.
        passive_range: Limits of passive joints, (2, n_passive) [m or rad]; infinite where there are none.
        turning, sliding: Which passive joints turn, (n_passive,), and which motors slide, (n_actuated,).
        range: What each motor can be moved through, (2, n_actuated) [m or rad].
        home: Motors at home, (n_actuated,) [m or rad].
        targets: Name and body of each target.
        length: Characteristic length [m].
        terms: Whether joints of the calibrated robot do something beside what they are told, which a page leaves out.
    """

    by_actuated: FloatArray
    by_passive: FloatArray
    constant: FloatArray
    columns: tuple[int, ...]
    loops: tuple[RelativeFrame, ...]
    passive_range: FloatArray
    turning: tuple[bool, ...]
    sliding: tuple[bool, ...]
    range: FloatArray
    home: FloatArray
    targets: tuple[tuple[str, int], ...]
    length: float
    terms: bool

    def to_dict(self) -> dict[str, Any]:
        """Return the drive as the page's script reads it; limits that are none are null."""
        return {
            "by_actuated": self.by_actuated.tolist(),
            "by_passive": self.by_passive.tolist(),
            "constant": self.constant.tolist(),
            "columns": list(self.columns),
            "loops": [{"a": one.a, "b": one.b, "full": one.full_pose, "rows": list(one.rows)} for one in self.loops],
            "passive_range": [[value if np.isfinite(value) else None for value in ends] for ends in self.passive_range],
            "turning": list(self.turning),
            "sliding": list(self.sliding),
            "range": self.range.tolist(),
            "home": self.home.tolist(),
            "targets": [{"name": name, "body": body} for name, body in self.targets],
            "length": self.length,
            "terms": self.terms,
        }


def drive_of(robot: Robot, bodies: Bodies, shown: FloatArray) -> Drive:
    """Return how a robot can be moved by hand.

    Args:
        robot: The robot that is drawn solid.
        bodies: Its tree.
        shown: Motors in the poses shown, (n, n_actuated) [m or rad]: their range holds these.
    """
    mechanism, moving = robot.mechanism, bodies.moving
    names = [mechanism.origin_names[joint] for joint in moving]
    joints = {joint.name: joint for joint in robot.urdf.joints}
    sliding = np.array([joints[name].type == "prismatic" for name in robot.joint_names], dtype=bool)
    reach = np.where(sliding, mechanism.length, np.pi)  # to both sides of home, where there are no limits
    low, high = (np.array([getattr(joints[name], end) for name in robot.joint_names]) for end in ("lower", "upper"))
    low = np.where(np.isfinite(low), low, robot.home - reach)
    high = np.where(np.isfinite(high), high, robot.home + reach)
    return Drive(
        mechanism.select_actuated[moving],
        mechanism.select_passive[moving],
        mechanism.constant[moving],
        tuple(names.index(name) for name in mechanism.passive),
        mechanism.loops,
        np.stack([mechanism.lower, mechanism.upper]),
        tuple((~mechanism.is_metre_column).tolist()),
        tuple(sliding.tolist()),
        np.stack([np.min([low, *shown], axis=0), np.max([high, *shown], axis=0)]),
        robot.home,
        tuple((name, target.b) for name, target in zip(robot.target_names, mechanism.targets, strict=True)),
        mechanism.length,
        bool(robot.terms),
    )
