"""Poses free of collisions, and the information that leaving out the others costs.

`calib.motion` checks poses; it is found by the entry point `check_poses` of the group `calib.methods`.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray
from calib.core.base.errors import DataError
from calib.core.base.registry import load_entry
from calib.core.base.words import count_noun, listing
from calib.core.data.measurements import Poses
from calib.core.numerics.identifiability import numerical_rank
from calib.core.numerics.observability import observability
from calib.core.robots.robot import Robot
from calib.core.robots.robot_data import RobotData
from calib.shared.candidates import rows_of_measured

_PAIRS_SHOWN = 4


@dataclass(frozen=True)
class PoseCheck:
    """Collisions at poses.

    Attributes:
        hits: The pair that touches at each pose, such as `forearm - table`, or what hides a target; "" where it is
            free, (n,).
        remarks: Shapes that stand for links, and pairs that are not checked.
        unchecked: Why nothing was checked; "" where it was.
    """

    hits: tuple[str, ...]
    remarks: tuple[str, ...] = ()
    unchecked: str = ""

    @property
    def is_free(self) -> BoolArray:
        """Mask of the free poses, (n,)."""
        return np.array([not hit for hit in self.hits], dtype=bool)

    @property
    def n_blocked(self) -> int:
        """Number of poses that are not free."""
        return sum(map(bool, self.hits))

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks on shapes and pairs; or that nothing was checked, and why."""
        return (f"collisions are not checked: {self.unchecked}",) if self.unchecked else self.remarks

    def summary(self) -> str:
        """Say how many poses are not free, and by which pairs; "" where all are."""
        return blocking_sentence(Counter(filter(None, self.hits)), len(self.hits))


def blocking_sentence(pairs: Counter[str], n: int) -> str:
    """Say by which pairs poses are not free, of n that were looked at; "" where all are free."""
    if not pairs:
        return ""
    named = [f"{count} {pair}" for pair, count in pairs.most_common(_PAIRS_SHOWN)]
    if len(pairs) > _PAIRS_SHOWN:
        named.append(count_noun(len(pairs) - _PAIRS_SHOWN, "further pair"))
    return f"{sum(pairs.values())} of {count_noun(n, 'pose')} not free ({listing(named)})"


def check_poses(robot: RobotData, joints: FloatArray) -> PoseCheck:
    """Return the check at joints (n, n_actuated) [m or rad]; an impossible obstacle or mesh is a `DescriptionError`."""
    return load_entry("calib.methods", "check_poses")(robot, joints)


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
    ranks = [numerical_rank(rows_of_measured(robot, poses, None)) for poses in (kept, every)]
    if not ranks[1].rank:
        return "no reading there depends on a free parameter"
    if ranks[0].rank < ranks[1].rank:
        return f"they determine {ranks[0].rank} combinations of parameters, and {ranks[1].rank} with nothing in the way"
    values = [
        observability(rank.singular_values[: ranks[1].rank], len(poses))["O1"]
        for rank, poses in zip(ranks, (kept, every), strict=True)
    ]
    return f"O1 is {100 * values[0] / values[1]:.1f} % of what it would be with nothing in the way"
