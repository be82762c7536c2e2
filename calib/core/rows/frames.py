"""The frames of places, the calibrated robot in them, and the uncertainty of its positions there.

The frame of a program. Where the base is known, and some instrument looks from a known place, a program is meant in the
measurement frame: every error of the robot's links counts there. This includes errors that readings cannot tell from
another place of a measured point on its link. The place itself does not count: it is no error of the robot.
Where the base is unknown, the tracker may have stood anywhere, and the place of the nominal robot's base frame on the
real robot is unknown. Then a program is meant in the robot's own base frame, placed where the nominal and the
calibrated robot agree best over the measured poses (`calib.core.rows.common_motion`). A measured point whose place on
its link is unknown is placed on the nominal robot's link in the same way. So no error is corrected or counted that may
as well belong to base or tool.

The measurement frame. Goals in the measurement frame are places of the measured point in the frame in which it was
measured. Base and target are where the calibration found them.
The fit may find an error of the robot that readings cannot tell from another place of the measured point on its link.
It is not corrected. If a program is in the measurement frame, it is counted: the robot most likely has this error.
With d the error of the parameters and J' the derivative of positions by them, positions are off by J' d. For goals in
the measurement frame, all parameters count. For a program in the measurement frame, those of the robot itself count.
For a program in the robot's own base frame, the common motion that follows d is subtracted. The stated covariance is
that of J' d. It counts the noise of the measurements and the priors of undetermined combinations, as far as a position
in this frame depends on them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, ReadOnlyArrays
from calib.core.base.contributions import Contribution, Contributions
from calib.core.base.threads import one_blas_thread
from calib.core.base.words import count_noun
from calib.core.robots.jacobian import linearise
from calib.core.robots.robot import Robot
from calib.core.robots.terms.term import Context
from calib.core.rows.common_motion import CommonMotion, UnknownPlaces, target_poses
from calib.core.rows.gauge import nearest_to_nominal, poses_around_home
from calib.core.rows.known_robot import KnownRobot
from calib.core.rows.prediction import ParameterUncertainty, PositionUncertainty, UncertaintyJacobian

_MOST = 400  # poses over which robots are aligned


@dataclass(frozen=True, eq=False)
class CorrectionFrame(ReadOnlyArrays):
    """A calibrated robot and the frame of its places. Both robots are seen from the measurement frame.

    Attributes:
        known: The calibrated robot with its uncertainty.
        robot: The calibrated robot; its own parameters are as near to nominal as readings allow.
        meant: The nominal robot, with its base and tools placed in this frame.
        nominal: The robot of the description.
        words: Name of the frame in a sentence.
        counts: Mask of the free parameters that move positions in this frame, (n_free,).
        motion: The common motion that does not count; None where all counts.
    """

    known: KnownRobot
    robot: Robot
    meant: Robot
    nominal: Robot
    words: str
    counts: BoolArray
    motion: CommonMotion | None

    @property
    def nothing_to_correct(self) -> bool:
        """Whether the verdict keeps the commands of the nominal robot."""
        return self.known.nothing_to_correct

    @property
    def contains(self) -> Contributions:
        """Contributions to errors in this frame; none where they are not known."""
        known = self.known.uncertainty
        if known is None:
            return frozenset()
        return known.contains if self.motion is None else known.contains | {Contribution.FRAME}

    def predict(self, q: FloatArray, context: Context | None = None) -> PositionUncertainty:
        """Predict positions of all targets in this frame, with their covariance; NaN where it is not known.

        Args:
            q: Commands, (n, n_actuated) [m or rad].
            context: Conditions of the commands.

        Raises:
            UnreachablePoseError: A loop stays open.
        """
        uncertainty = self.known.uncertainty
        if uncertainty is None:
            positions = target_poses(self.robot, self.robot.assemble(q, context=context))[0]
            unknown = np.full((*positions.shape, 3), np.nan)
            return PositionUncertainty(positions, unknown, np.nan, unknown, self.robot.unreported_targets)
        counts = uncertainty.counting(self.robot, self.counts)
        predicted = uncertainty.predict(self.robot, q, context, counts=counts, common=self._common)
        return PositionUncertainty(
            predicted.positions,
            predicted.covariance,
            predicted.coverage_factor,
            predicted.turn_covariance,
            self.robot.unreported_targets,
            contains=self.contains,
        )

    def uncorrected_errors(self, q: FloatArray, context: Context) -> FloatArray:
        """Return the errors of positions [m] and turns [rad] that the fit found but that are not corrected.

        Args:
            q: Commands, (n, n_actuated) [m or rad].
            context: Conditions of the commands.

        Returns:
            In the axes of the frame, (n, n_targets, 6).
        """
        uncertainty, shape = self.known.uncertainty, (len(q), len(self.robot.target_names), 6)
        if uncertainty is None or self.motion is not None:  # such errors are part of the common motion
            return np.zeros(shape)
        left = (self.known.robot.values - self.robot.values)[uncertainty.free][self.counts]
        if not np.any(left):
            return np.zeros(shape)
        linear = linearise(self.robot, self.robot.assemble(q, context=context), turns=True)
        return np.asarray(linear.jacobian[..., uncertainty.free][..., self.counts] @ left)

    @cached_property
    def _common(self) -> Callable[[UncertaintyJacobian], tuple[FloatArray, FloatArray]] | None:
        """The common motion that follows errors of uncertain parameters; None where all counts."""
        if self.motion is None or self.known.uncertainty is None:
            return None
        return following_motion(self.motion, self.robot, self.known.uncertainty)


def following_motion(
    motion: CommonMotion, robot: Robot, uncertainty: ParameterUncertainty
) -> Callable[[UncertaintyJacobian], tuple[FloatArray, FloatArray]]:
    """Return a function that gives the derivative of the common motion by the uncertain parameters, as a product.

    The derivative is that of each target's motion, (n, n_targets, 6, m) times (m, n_uncertain).
    """
    linear = uncertainty.linearise(robot, motion.joints, Context.neutral(*motion.joints.shape))
    following = motion.following(linear.jacobian) * uncertainty.lasting(robot)
    return partial(_common, motion, following)


def _common(motion: CommonMotion, following: FloatArray, linear: UncertaintyJacobian) -> tuple[FloatArray, FloatArray]:
    """Factors of the derivative of the common motion by the uncertain quantities; see `following_motion`."""
    return motion.columns(*target_poses(linear.robot, linear.configurations)), following


def as_described(robot: Robot) -> Robot:
    """Return the robot of the description, without joint terms."""
    bare = robot.with_terms(())
    return bare.with_nominal_values()


@one_blas_thread
def program_frame(known: KnownRobot) -> CorrectionFrame:
    """Return the frame in which a program for the nominal robot is meant; see the module docstring."""
    nominal, robot = as_described(known.robot), nearest_to_nominal(known.robot)
    loose, of_robot = UnknownPlaces.from_robot(nominal), _is_of_robot(known)
    if loose.base:
        motion = _align_nominal(nominal, robot, loose, known)
        poses = f"over {count_noun(len(motion.joints), 'measured pose')}" if len(known.joints) else "around home"
        tool = ", and so is its tool" if loose.points or loose.frames else ""
        words = f"in the nominal robot's base frame (fitted to the calibrated robot {poses}{tool})"
        return CorrectionFrame(
            known, robot, motion.robot, nominal, words, np.ones_like(of_robot), motion if motion.basis.size else None
        )
    places = {p.name: value for p, value in zip(robot.parameters, robot.values, strict=True) if p.placement}
    words = "in the measurement frame"
    if loose.points or loose.frames:
        words += ", and the unknown place of the measured point on its link counts as an error"
    meant = nominal.with_parameters(places) if places else nominal
    return CorrectionFrame(known, robot, meant, nominal, words, of_robot, None)


@one_blas_thread
def measurement_frame(known: KnownRobot) -> CorrectionFrame:
    """Return the frame in which the instruments see places; see the module docstring."""
    nominal, placed = as_described(known.robot), any(parameter.placement for parameter in known.robot.parameters)
    meant = (
        _align_nominal(nominal, known.robot, UnknownPlaces.from_robot(nominal), known).robot
        if known.nothing_to_correct
        else nominal
    )
    calibrated = any(
        p.placement and v != p.nominal_si for p, v in zip(known.robot.parameters, known.robot.values, strict=True)
    )
    where = "the calibration found" if calibrated else "the robot description has"
    words = "in the measurement frame" + (f", base and targets where {where} them" if placed else "")
    return CorrectionFrame(known, known.robot, meant, nominal, words, np.ones_like(_is_of_robot(known)), None)


def _is_of_robot(known: KnownRobot) -> BoolArray:
    """Mask of the free parameters of the robot itself, without placements, (n_free,)."""
    of_robot = np.array([not parameter.placement for parameter in known.robot.parameters])
    return of_robot[:0] if known.uncertainty is None else of_robot[known.uncertainty.free]


def _align_nominal(nominal: Robot, robot: Robot, loose: UnknownPlaces, known: KnownRobot) -> CommonMotion:
    """The nominal robot aligned with the calibrated one over the measured poses."""
    return CommonMotion.from_robots(nominal, robot, loose, poses_of_agreement(known, nominal))


def poses_of_agreement(known: KnownRobot, nominal: Robot) -> FloatArray:
    """Return the poses over which the nominal and the calibrated robot are aligned, (n, n_actuated) [m or rad]."""
    measured = np.unique(known.joints, axis=0)
    chosen = measured[np.unique(np.linspace(0, len(measured) - 1, _MOST).astype(np.intp))] if len(measured) else None
    joints = poses_around_home(nominal) if chosen is None else chosen
    return np.asarray(joints[nominal.close(joints).ok & known.robot.close(joints).ok])
