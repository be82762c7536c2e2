"""A calibrated robot with its uncertainty, and the frame in which the uncertainty of its positions is reported.

If an instrument stands at a known place, this is the measurement frame. Otherwise readings may hardly determine the
places of base and instruments. Distances from unknown points, for example, leave the place of the base to its priors,
with an uncertainty of millimetres, although no motion of the robot is that uncertain. Then positions are reported in
the robot's own base frame, placed where predicted and true positions agree best over the measured poses. The place of
the target on its link counts in either frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, ReadOnlyArrays, evenly_spread
from calib.core.base.contributions import Contribution
from calib.core.base.threads import one_blas_thread
from calib.core.robots.joint_sampling import joint_samples
from calib.core.robots.robot import Robot
from calib.core.robots.terms.term import Context
from calib.core.rows.common_motion import CommonMotion, UnknownPlaces
from calib.core.rows.prediction import ParameterUncertainty, PositionUncertainty

OWN_FRAME = "in the robot's own base frame, because no instrument stands at a known place"
"""Name of the frame of the report if it is not the measurement frame."""
_MOST = 400  # poses over which robots are aligned
_POSES_AROUND = 256
_AROUND_HOME = 0.5  # motion is analytic: these poses show all that any poses show [rad, or characteristic lengths]


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


@dataclass(frozen=True, eq=False)
class ReportedUncertainty(ReadOnlyArrays):
    """A calibrated robot and its uncertainty in a frame.

    Attributes:
        motion: The common motion that does not count; None where all counts, in the measurement frame.
        counts: Mask of the free parameters that move positions in this frame, (n_free,); all if not given.
    """

    robot: Robot
    uncertainty: ParameterUncertainty
    motion: CommonMotion | None
    counts: BoolArray | None = None

    @staticmethod
    @one_blas_thread
    def from_robot(robot: Robot, uncertainty: ParameterUncertainty, joints: FloatArray) -> ReportedUncertainty:
        """Return the reported uncertainty of a robot calibrated at commands `joints`, (n, n_actuated) [m or rad]."""
        loose = replace(UnknownPlaces.from_robot(robot), points=(), frames=())
        if not loose.base:
            return ReportedUncertainty(robot, uncertainty, None)
        motion = CommonMotion.from_robots(robot, robot, loose, poses_of_agreement(robot, robot, joints))
        return ReportedUncertainty(robot, uncertainty, motion if motion.basis.size else None)

    @property
    def notes(self) -> tuple[str, ...]:
        """A sentence on the frame of the report, if it is not the measurement frame."""
        return () if self.motion is None else (f"the uncertainty of predicted positions is given {OWN_FRAME}",)

    def predict(
        self, q: FloatArray, context: Context | None = None, near: FloatArray | None = None, *, turns: bool = True
    ) -> PositionUncertainty:
        """Predict positions in the measurement frame, with their covariance in this frame.

        Commands are q, (n_poses, n_actuated) [m or rad]; for the other arguments see `ParameterUncertainty.predict`. A
        loop that stays open is an `UnreachablePoseError`.
        """
        counts = None if self.counts is None else self.uncertainty.counting(self.robot, self.counts)
        common = None if self.motion is None else (self.motion, self._following)
        known = self.uncertainty.predict(self.robot, q, context, near, turns=turns, counts=counts, common=common)
        if common is None:
            return known
        return replace(known, frame=OWN_FRAME, contains=known.contains | {Contribution.FRAME})

    @cached_property
    def _following(self) -> FloatArray:
        """Derivative of the common motion z by the uncertain quantities, (k, n_uncertain)."""
        assert self.motion is not None
        joints = self.motion.joints
        linear = self.uncertainty.linearise(self.robot, joints, Context.neutral(*joints.shape), turns=False)
        return self.motion.following(linear.jacobian) * self.uncertainty.lasting(self.robot)


def poses_of_agreement(nominal: Robot, robot: Robot, joints: FloatArray) -> FloatArray:
    """Return measured poses `joints` that both robots can assemble, else poses around home, (n, n_actuated)."""
    measured = np.unique(joints, axis=0)
    some = measured[evenly_spread(len(measured), _MOST)]
    chosen = some if len(some) else poses_around_home(nominal)
    return np.asarray(chosen[nominal.close(chosen).ok & robot.close(chosen).ok])


def poses_around_home(robot: Robot) -> FloatArray:
    """Return joint values of reachable poses around home, (n, n_actuated) [m or rad]."""
    lower, upper = robot.urdf.limits(robot.joint_names)
    spread = joint_samples(robot.mode, _POSES_AROUND)[:, : len(robot.home)] - 0.5
    q = np.clip(robot.home + 2 * _AROUND_HOME * robot.mechanism.joint_scale * spread, lower, upper)
    return np.asarray(q[robot.close(q).ok])
