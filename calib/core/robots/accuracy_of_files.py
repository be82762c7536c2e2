"""The part of a robot that a file holds, and the robot that each kind of file gets.

A calibrated robot may have values that a file has no room for: terms of its joints' errors, origins behind the last
axis, or everything except the zeros of its joints. The values that the file does hold are right only together with the
lost ones: joint origins that were found together with a joint's curve are wrong without it. So a file never gets a part
of the robot. It gets the best robot of those that it can hold whole, fitted to the same measurements, with the accuracy
of that robot at poses that its fit has not seen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from calib.core.base.arrays import FloatArray, ReadOnlyArrays
from calib.core.base.units import ERROR_UNIT, Dimension, quantity_text
from calib.core.base.words import count_noun
from calib.core.robots.terms.term import JointTerm


class Holds(Enum):
    """The part of a calibrated robot that a file holds, in words."""

    EVERYTHING = "the whole model"
    TABLES = "joint origins, and a table of each joint's own error"
    ORIGINS = "joint origins"
    TO_LAST_AXIS = "joint origins up to the last axis"
    ZEROS = "a zero for each joint"

    def keeps(self, term: JointTerm | type[JointTerm]) -> bool:
        """Whether a term of a joint's error is held."""
        return self is Holds.EVERYTHING or (self is Holds.TABLES and term.follows_joint_alone())


class PoseUse(Enum):
    """How the fit used the poses at which errors are computed, in words."""

    VALIDATION = "validation"
    FOLDS = "left out in turn"
    ONE_BY_ONE = "left out one by one"
    USED = "used"


@dataclass(frozen=True)
class Accuracy:
    """Error of a robot at a set of poses, and of the nominal one there.

    `calib.core.fitting.unseen_errors` has the definitions.

    Attributes:
        poses: The poses, in words.
        n_poses: Number of poses.
        part: Part of the readings there, such as `position`.
        dimension: Its dimension.
        before: Root mean square error of the nominal robot, with only base and targets placed [SI].
        rms: Root mean square error of the robot [SI].
        limit95: Limit below which the error at one more such pose stays with a chance of 95 % or more [SI]; NaN where
            the poses are too few to say.
        is_position: Whether positions were read (`calib.core.instruments.kind.Part`).
        readings: Name of the readings there in a sentence, such as `distances`.
    """

    poses: PoseUse
    n_poses: int
    part: str
    dimension: Dimension
    before: float
    rms: float
    limit95: float
    is_position: bool = False
    readings: str = "readings"

    @property
    def pose_words(self) -> str:
        """The poses in words."""
        if self.poses is PoseUse.VALIDATION:
            return f"{self.n_poses} validation poses"
        return f"{count_noun(self.n_poses, 'pose')} {self.poses.value}"

    def in_unit(self, error: float) -> str:
        """Return an error [SI] with its unit."""
        return quantity_text(error, ERROR_UNIT[self.dimension], ".4f")

    @property
    def words(self) -> str:
        """One clause: its error, the limit of nearly all errors, and where."""
        limit = f", 95 % within {self.in_unit(self.limit95)}" if np.isfinite(self.limit95) else ""
        return f"{self.in_unit(self.rms)} RMS{limit} ({self.pose_words})"


@dataclass(frozen=True, eq=False)
class FileRobot(ReadOnlyArrays):
    """The robot for files of one kind (`Holds`).

    Attributes:
        values: Values of all its parameters, by name [SI]; none where it is the nominal robot with joint zeros.
        accuracy: Its accuracy.
        withheld: Reason why files get it only by force (`--force`); empty if there is none.
        signs, offsets: Joint zeros: joints are at sign * q + offset at command q, (n_actuated,) [m or rad];
            empty where the values say all.
    """

    values: Mapping[str, float]
    accuracy: Accuracy
    withheld: str = ""
    signs: FloatArray = field(default_factory=lambda: np.zeros(0))
    offsets: FloatArray = field(default_factory=lambda: np.zeros(0))
