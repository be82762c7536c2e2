"""Poses free of collisions, and colliding pairs, for planning and pages (`check_poses`)."""

from __future__ import annotations

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import UrdfError
from calib.core.base.memoize import memoize
from calib.core.robots.robot import Robot
from calib.motion.allowed_contacts import build_scene, home_and_more
from calib.motion.shapes import has_collision_shapes, missing_meshes
from calib.motion.sight import Sight, sight_lines
from calib.motion.surroundings import UNCHECKED
from calib.shared.pose_check import PoseCheck

_SAMPLES = 100  # poses from which shapes that always hide a line are found


def why_unchecked(robot: Robot) -> str:
    """Return the reason why nothing is checked; "" if the robot has collision shapes or the description needs it."""
    description = robot.description
    if description.obstacles == UNCHECKED:
        return f"the description says 'obstacles: {UNCHECKED}'"
    stated: list[object] = [description.obstacles, description.sight]
    stated += [each for target in description.targets.values() for each in (target.shape, target.acceptance)]
    if any(each is not None for each in stated):
        return ""
    try:
        if not has_collision_shapes(robot):
            return "the robot file has no collision shapes, and the description names no obstacles"
        missing = missing_meshes(robot)
    except UrdfError as error:
        return str(error)
    return f"mesh '{missing[0]}' of {robot.urdf.path} is not there" if missing else ""


@memoize
def surroundings(robot: Robot) -> Sight:
    """Return the scene of a robot with its lines of sight.

    Raises:
        DescriptionError: A mesh is missing, an SRDF is of another robot, or an obstacle surrounds the robot.
    """
    sight = Sight(build_scene(robot), tuple(sight_lines(robot)))
    if not sight.lines:
        return sight
    joints, ok = sight.scene.configurations(home_and_more(robot, _SAMPLES, 1))
    return sight.without_ends(joints[ok])


def what_hits(robot: Robot, joints: FloatArray) -> tuple[str, ...]:
    """Return the colliding pair, or the hiding shape, at commands (n, n_actuated) [m or rad], (n,); "" for none.

    Raises:
        DescriptionError: See `surroundings`.
    """
    sight = surroundings(robot)
    hits = np.array(sight.scene.hits(joints), dtype=object)
    free = np.flatnonzero(hits == "")
    if sight.lines and len(free):
        hits[free] = sight.hidden_targets(sight.scene.configurations(joints[free])[0])
    return tuple(hits)


def check_poses(robot: Robot, joints: FloatArray) -> PoseCheck:
    """Return the check of commands (n, n_actuated) [m or rad]; see `calib.shared.pose_check`.

    Raises:
        DescriptionError: See `surroundings`.
    """
    unchecked = why_unchecked(robot)
    if unchecked:
        return PoseCheck(("",) * len(joints), (), unchecked)
    return PoseCheck(what_hits(robot, joints), surroundings(robot).scene.remarks)
