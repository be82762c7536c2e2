"""Uncertainty of positions, in the frame in which they are reported.

If an instrument stands at a known place, this is the measurement frame. Otherwise readings may hardly determine the
places of base and instruments. Distances from unknown points, for example, leave the place of the base to its priors,
with an uncertainty of millimetres, although no motion of the robot is that uncertain. Then positions are reported in
the robot's own base frame, placed where predicted and true positions agree best over the measured poses.

Let J be the derivative of positions by the free parameters, d the error of the parameters, and C its covariance. Let
A z(d) be the motion of all positions as one body that fits J d best over these poses (`calib.core.rows.common_motion`).
The reported covariance is the covariance of J d - A z(d). The place of the target on its link counts in either frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

from calib.core.base.arrays import FloatArray, ReadOnlyArrays
from calib.core.base.contributions import Contribution
from calib.core.base.threads import one_blas_thread
from calib.core.robots.robot import Robot
from calib.core.robots.terms.term import Context
from calib.core.rows.common_motion import CommonMotion, UnknownPlaces
from calib.core.rows.frames import following_motion, poses_of_agreement
from calib.core.rows.known_robot import KnownRobot
from calib.core.rows.prediction import ParameterUncertainty, PositionUncertainty, UncertaintyJacobian

OWN_FRAME = "in the robot's own base frame, because no instrument stands at a known place"
"""Name of the frame of the report if it is not the measurement frame."""


@dataclass(frozen=True, eq=False)
class ReportedUncertainty(ReadOnlyArrays):
    """A calibrated robot, its uncertainty, and the common motion to subtract; None in the measurement frame."""

    robot: Robot
    uncertainty: ParameterUncertainty
    motion: CommonMotion | None

    @staticmethod
    @one_blas_thread
    def from_robot(robot: Robot, uncertainty: ParameterUncertainty, joints: FloatArray) -> ReportedUncertainty:
        """Return the reported uncertainty of a robot calibrated at commands `joints`, (n, n_actuated) [m or rad]."""
        loose = replace(UnknownPlaces.from_robot(robot), points=(), frames=())
        if not loose.base:
            return ReportedUncertainty(robot, uncertainty, None)
        known = KnownRobot(robot, uncertainty, joints, nothing_to_correct=False)
        motion = CommonMotion.from_robots(robot, robot, loose, poses_of_agreement(known, robot))
        return ReportedUncertainty(robot, uncertainty, motion if motion.basis.size else None)

    @property
    def notes(self) -> tuple[str, ...]:
        """A sentence on the frame of the report, if it is not the measurement frame."""
        return () if self.motion is None else (f"the uncertainty of predicted positions is given {OWN_FRAME}",)

    def predict(
        self, q: FloatArray, context: Context | None = None, near: FloatArray | None = None, *, turns: bool = True
    ) -> PositionUncertainty:
        """Predict positions in the measurement frame, with their covariance in the frame of the report.

        Args:
            q: Commands, (n_poses, n_actuated) [m or rad].
            context: Conditions of the commands; joint terms may depend on them.
            near: Passive joints to start from, if they are known, (n_poses, n_passive) [m or rad].
            turns: Whether to compute the covariance of the orientations as well.

        Raises:
            UnreachablePoseError: A loop stays open.
        """
        if self.motion is None:
            return self.uncertainty.predict(self.robot, q, context, near, turns=turns)
        reported = self.uncertainty.predict(self.robot, q, context, near, turns=turns, common=self._common)
        return replace(reported, frame=OWN_FRAME, contains=reported.contains | {Contribution.FRAME})

    @cached_property
    def _common(self) -> Callable[[UncertaintyJacobian], tuple[FloatArray, FloatArray]]:
        """Function that returns the derivative of the common motion by the parameters."""
        assert self.motion is not None
        return following_motion(self.motion, self.robot, self.uncertainty)
