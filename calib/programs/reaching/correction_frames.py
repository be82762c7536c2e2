"""The frames of places for a calibrated robot, and the robot in them.

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

The gauge. If the base is unknown, the origin of the first joint and the base can move together without changing a
measurement; so can the last origin and an unknown target. A fit moves whatever the priors let move most cheaply, so
that a reflector 2 mm off its stated place leaves some hundredths of a millimetre in the last joint's origin. A
correction of the robot must not include that.
Let r be the change of the readings at many poses, J their derivative by the scaled parameters u = (p - p_nominal) / s,
N the combinations of u that no reading sees (J N = 0), and D the selection of the parameters of the robot itself. The
values along N are free, and chosen as

    u' = u - J^+ r + N z,      z minimises |D (u - J^+ r + N z)|^2

repeatedly until u' no longer changes. The robot is then as near its nominal one as the measurements allow, base and
targets take the rest, and no reading has changed (N alone would ensure that in the first order only).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, ReadOnlyArrays
from calib.core.base.contributions import Contribution, Contributions
from calib.core.base.threads import one_blas_thread
from calib.core.base.words import count_noun
from calib.core.numerics import linalg
from calib.core.numerics.identifiability import RANK_TOLERANCE, reduce_rows
from calib.core.robots.jacobian import linearise
from calib.core.robots.loading import RobotLike, as_robot
from calib.core.robots.robot import Robot
from calib.core.robots.terms.term import Context
from calib.core.rows.common_motion import CommonMotion, UnknownPlaces, target_poses
from calib.core.rows.frames import KnownRobot, ReportedUncertainty, poses_around_home, poses_of_agreement
from calib.core.rows.observed import Observed, observe, predict_readings
from calib.core.rows.prediction import PositionUncertainty

_ROUNDS = 10
_CONVERGED = 1e-6  # largest change of a scaled parameter at the end; the next one is about its square


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


@dataclass(frozen=True, eq=False)
class CorrectionFrame(ReadOnlyArrays):
    """A calibrated robot and the frame of its places. Both robots are seen from the measurement frame.

    Attributes:
        known: The calibrated robot with its uncertainty.
        robot: The calibrated robot; its own parameters are as near to nominal as readings allow.
        meant: The nominal robot, with its base and tools placed in this frame.
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

        Raises:
            UnreachablePoseError: A loop stays open.
        """
        if self._reported is not None:
            return self._reported.predict(q, context)
        positions = target_poses(self.robot, self.robot.assemble(q, context=context))[0]
        unknown = np.full((*positions.shape, 3), np.nan)
        return PositionUncertainty(positions, unknown, np.nan, unknown, self.robot.unreported_targets)

    @cached_property
    def _reported(self) -> ReportedUncertainty | None:
        known = self.known.uncertainty
        return None if known is None else ReportedUncertainty(self.robot, known, self.motion, self.counts)

    def uncorrected_errors(self, q: FloatArray, context: Context) -> FloatArray:
        """Return the errors of positions [m] and turns [rad] that the fit found but that are not corrected.

        Args:
            q: Commands, (n, n_actuated) [m or rad].

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
    of_robot = np.array([not parameter.placement for parameter in known.robot.parameters])
    return of_robot[:0] if known.uncertainty is None else of_robot[known.uncertainty.free]


def _align_nominal(nominal: Robot, robot: Robot, loose: UnknownPlaces, known: KnownRobot) -> CommonMotion:
    return CommonMotion.from_robots(nominal, robot, loose, poses_of_agreement(nominal, known.robot, known.joints))


@one_blas_thread
def nearest_to_nominal(robot: Robot) -> Robot:
    """Return a robot with the same readings, its own parameters as near to nominal as these allow.

    A calibrated robot whose base and targets are known comes back unchanged.
    """
    parameters = robot.parameters[: robot.n_origin_parameters]
    free = np.flatnonzero(robot.is_free[: len(parameters)])
    of_robot = np.array([not parameters[k].placement for k in free], dtype=bool)
    if np.all(of_robot):
        return robot
    sigma = robot.parameters.sigma_si[free]
    expected = robot.parameters.expected_si[free]
    q = poses_around_home(robot)
    predicted = predict_readings(robot, robot.assemble(q))  # NaN outside of an image; set to 0 below
    readings = {name: replace(reading, values=np.nan_to_num(reading.values)) for name, reading in predicted.items()}
    before, _ = _stack(observe(robot, robot.assemble(q), readings))
    for _ in range(_ROUNDS):
        now, jacobian = _stack(observe(robot, robot.assemble(q), readings))
        changed = now - before
        seen, unseen = _split_space(jacobian[:, free] * sigma)
        back = -seen @ linalg.lstsq(jacobian[:, free] * sigma @ seen, changed, rcond=None)
        start = (robot.values[free] - expected) / sigma + back
        step = back - unseen @ linalg.lstsq(unseen[of_robot], start[of_robot], rcond=RANK_TOLERANCE)
        values = robot.values.copy()
        values[free] += sigma * step
        robot = robot.with_parameters(values)
        if np.max(np.abs(step), initial=0.0) < _CONVERGED:
            break
    return robot


def _split_space(scaled: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Combinations of the columns that have an effect, and those that vanish, orthonormal, (n_columns, n) each."""
    _, singular, right = linalg.svd(reduce_rows(scaled), full_matrices=True)
    rank = int(np.sum(singular > RANK_TOLERANCE * singular[0]))
    return right[:rank].T, right[rank:].T


def _stack(observed: Mapping[str, Observed]) -> tuple[FloatArray, FloatArray]:
    """Residuals (n_rows,) and Jacobian (n_rows, n_parameters) of all instruments [SI]; 0 where not read."""
    residuals = np.concatenate([block.residuals.ravel() for block in observed.values()])
    jacobian = np.concatenate([block.jacobian.reshape(-1, block.jacobian.shape[2]) for block in observed.values()])
    return np.nan_to_num(residuals), np.nan_to_num(jacobian)
