"""A calibrated robot with its uncertainty and the measured poses, for every correction of a robot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from calib.core.base.arrays import FloatArray, ReadOnlyArrays
from calib.core.robots.loading import RobotLike, as_robot
from calib.core.robots.robot import Robot
from calib.core.rows.prediction import ParameterUncertainty


@dataclass(frozen=True, eq=False)
class KnownRobot(ReadOnlyArrays):
    """A calibrated robot.

    Attributes:
        uncertainty: Uncertainty of its parameters; None where not stated.
        joints: Joint values of the visits in the fit, (n, n_actuated) [m or rad].
        nothing_to_correct: Whether the verdict finds the nominal values as good as any.
    """

    robot: Robot
    uncertainty: ParameterUncertainty | None
    joints: FloatArray
    nothing_to_correct: bool


@runtime_checkable
class Calibrated(Protocol):
    """An object with a calibrated robot: a fit, or a loaded result."""

    @property
    def known_robot(self) -> KnownRobot:
        """The calibrated robot with its uncertainty."""


def known_robot(calibrated: RobotLike | Calibrated | KnownRobot) -> KnownRobot:
    """Return a known robot, or raise `InputError`; a robot alone has values but no uncertainty."""
    if isinstance(calibrated, KnownRobot):
        return calibrated
    if isinstance(calibrated, Calibrated):
        return calibrated.known_robot
    robot = as_robot(calibrated)
    return KnownRobot(robot, None, np.zeros((0, len(robot.joint_names))), nothing_to_correct=False)
