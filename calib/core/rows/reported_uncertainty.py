"""How well positions are known in the frame in which they are reported.

Where some instrument looks from a known place, that is the measurement frame. Where none does, the base and all that
measures stand anywhere, and readings may hardly tell where: distances from unknown points leave the base to its priors,
millimetres of them, and nothing that the robot does is a millimetre off. Then positions are reported in the robot's own
base frame, laid where positions agree best over the poses measured.

With J the derivative of positions by the free parameters and C their covariance, d the error of the parameters and z(d)
the motion of all positions as one body that follows it best over those poses (`calib.core.rows.common_motion`), the
covariance reported is that of J d - A z(d). Where the measured point is on its link counts in either frame.
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
"""Which frame it is where that is not the measurement frame."""


@dataclass(frozen=True, eq=False)
class ReportedUncertainty(ReadOnlyArrays):
    """A calibrated robot, and how well its positions are known.

    Attributes:
        robot: The robot.
        uncertainty: How well its parameters are known.
        motion: Common motion that does not count; None in the measurement frame.
    """

    robot: Robot
    uncertainty: ParameterUncertainty
    motion: CommonMotion | None

    @staticmethod
    @one_blas_thread
    def from_robot(robot: Robot, uncertainty: ParameterUncertainty, joints: FloatArray) -> ReportedUncertainty:
        """Return how well the positions of a calibrated robot are known.

        Args:
            robot: The robot.
            uncertainty: How well its parameters are known.
            joints: Of the visits that it was calibrated from, (n, n_actuated) [m or rad].
        """
        loose = replace(UnknownPlaces.from_robot(robot), points=(), frames=())
        if not loose.base:
            return ReportedUncertainty(robot, uncertainty, None)
        known = KnownRobot(robot, uncertainty, joints, nothing_to_correct=False)
        motion = CommonMotion.from_robots(robot, robot, loose, poses_of_agreement(known, robot))
        return ReportedUncertainty(robot, uncertainty, motion if motion.basis.size else None)

    @property
    def notes(self) -> tuple[str, ...]:
        """Say in which frame it is reported, where that is not the measurement frame."""
        return () if self.motion is None else (f"the uncertainty of predicted positions is given {OWN_FRAME}",)

    def predict(
        self, q: FloatArray, context: Context | None = None, near: FloatArray | None = None, *, turns: bool = True
    ) -> PositionUncertainty:
        """Predict positions in the measurement frame, with their covariance in the frame of the report.

        Args:
            q: Commands, (n_poses, n_actuated) [m or rad].
            context: Under which conditions they are given; joint terms may depend on it.
            near: Passive joints to start from, if they are known, (n_poses, n_passive) [m or rad].
            turns: Whether the covariance of the orientations is wanted.

        Raises:
            UnreachablePoseError: A loop stays open.
        """
        if self.motion is None:
            return self.uncertainty.predict(self.robot, q, context, near, turns=turns)
        reported = self.uncertainty.predict(self.robot, q, context, near, turns=turns, common=self._common)
        return replace(reported, frame=OWN_FRAME, contains=reported.contains | {Contribution.FRAME})

    @cached_property
    def _common(self) -> Callable[[UncertaintyJacobian], FloatArray]:
        """The common motion that follows what is uncertain."""
        assert self.motion is not None
        return following_motion(self.motion, self.robot, self.uncertainty)
