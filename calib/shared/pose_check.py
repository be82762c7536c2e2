"""Poses free of collisions: the interface of the capability that checks them.

`calib.motion` knows shapes; it is found by the entry point `check_poses` of the group `calib.methods`.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray
from calib.core.base.registry import load_entry
from calib.core.base.words import count_noun, listing
from calib.core.robots.robot_data import RobotData

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
