"""Poses without collisions, and the information that leaving out the others costs."""

from __future__ import annotations

import numpy as np

from calib.core.base.errors import DataError
from calib.core.data.measurements import Poses
from calib.core.numerics.identifiability import numerical_rank
from calib.core.numerics.observability import observability
from calib.core.robots.robot import Robot
from calib.shared.candidates import rows_of_measured
from calib.shared.pose_check import check_poses


def free_poses(robot: Robot, poses: Poses) -> tuple[Poses, tuple[str, ...]]:
    """Return the free poses, and notes on blocked ones and missing checks, or raise `DataError` if none is free."""
    check = check_poses(robot, poses.joints)
    if not check.n_blocked:
        return poses, check.notes
    if check.n_blocked == len(poses):
        raise DataError(f"{poses.path}: none of the poses is free: {check.summary()}")
    kept = poses.subset(np.flatnonzero(check.is_free))
    return kept, (f"left out: {check.summary()}; {worth_sentence(robot, kept, poses)}", *check.notes)


def worth_sentence(robot: Robot, kept: Poses, every: Poses) -> str:
    """Compare the free poses with all of them, by O1 or by the number of combinations that they determine."""
    if not np.any(robot.is_free):
        return "nothing is free to be identified"
    ranks = [numerical_rank(rows_of_measured(robot, poses, None)[0]) for poses in (kept, every)]
    if not ranks[1].rank:
        return "no reading there depends on a free parameter"
    if ranks[0].rank < ranks[1].rank:
        return f"they determine {ranks[0].rank} combinations of parameters, and {ranks[1].rank} with nothing in the way"
    values = [
        observability(rank.singular_values[: ranks[1].rank], len(poses))["O1"]
        for rank, poses in zip(ranks, (kept, every), strict=True)
    ]
    return f"O1 is {100 * values[0] / values[1]:.1f} % of what it would be with nothing in the way"
