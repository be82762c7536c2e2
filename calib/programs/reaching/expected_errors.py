"""The expected distance of a target from its goals at given commands.

Errors are in the frame of the goals (`calib.programs.reaching.correction_frames`) and normal. Their covariance is that
of the predicted position. Their mean is the known error of the calibrated robot that was not corrected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import FloatArray, IntArray, ReadOnlyArrays
from calib.core.base.contributions import Contributions, names_of
from calib.core.base.units import ERROR_UNIT, in_unit
from calib.core.robots.terms.term import Context
from calib.core.rows.common_motion import target_poses
from calib.core.rows.prediction import length95, rms_length
from calib.programs.reaching.correction_frames import CorrectionFrame
from calib.programs.reaching.goals import Goals


@dataclass(frozen=True, eq=False, kw_only=True)
class FramedErrors(ReadOnlyArrays):
    """Errors of a robot at goals, and what they are about.

    Attributes:
        frame: The frame of the goals and errors, in words.
        nothing_to_correct: Whether commands stay those of the nominal robot, as the verdict finds nothing to correct.
        contains: Contributions to the expected errors; none where they are not known.
    """

    frame: str
    nothing_to_correct: bool
    contains: Contributions

    @property
    def counted(self) -> str:
        """The contributions in words; results of format version 1 do not say them."""
        return ", ".join(names_of(self.contains)) or "what the calibration counted"


@dataclass(frozen=True, eq=False, repr=False)
class ExpectedError(FramedErrors):
    """Expected errors at goals; NaN where there is no command or the uncertainty of the robot is unknown.

    Attributes:
        distance: Root mean square distance along the stated coordinates of the goal, (n,) [m].
        distance95: Limits of the distance in 95 of 100 cases, (2, n) [m].
        angle: Root mean square angle from the orientation or z axis of the goal, (n,) [rad]; NaN if it has none.
        angle95: Limits of the angle in 95 of 100 cases, (2, n) [rad].
    """

    distance: FloatArray
    distance95: FloatArray
    angle: FloatArray
    angle95: FloatArray

    def __repr__(self) -> str:
        return f"<expected errors of {len(self.distance)} goals>"

    def figures(self) -> dict[tuple[str, str], FloatArray]:
        """Return errors (n,) and their limits for the stated components, by name and unit in files."""
        names = ("expected", "low95", "high95")
        parts = (self.distance, *self.distance95), (self.angle, *self.angle95)
        return shown_errors(names, [values for values in parts if np.any(np.isfinite(values[0]))])

    @staticmethod
    def from_frame(
        frame: CorrectionFrame, goals: Goals, commands: FloatArray, rows: IntArray, context: Context
    ) -> ExpectedError:
        """Return the expected errors at commands (n_rows, n_actuated) [m or rad] for the goals `rows` (n_rows,), in a
        frame.
        """
        errors = np.full((6, len(goals)), np.nan)
        if frame.known.uncertainty is not None and len(rows):
            errors[:, rows] = _errors(frame, goals.subset(rows), commands, context)
        return ExpectedError(errors[0], errors[1:3], errors[3], errors[4:], **words_of(frame))


def words_of(frame: CorrectionFrame) -> dict[str, Any]:
    """Return the fields of `FramedErrors` in a frame."""
    return {"frame": frame.words, "nothing_to_correct": frame.nothing_to_correct, "contains": frame.contains}


def shown_errors(names: Sequence[str], parts: Sequence[Sequence[FloatArray]]) -> dict[tuple[str, str], FloatArray]:
    """Return errors by name and unit in files.

    `parts` are errors of positions, each (n,) [m]; then of orientations, if these count, each (n,) [rad].
    """
    kinds = (("", ERROR_UNIT["length"]), ("_angle", ERROR_UNIT["angle"]))
    return {
        (f"{name}{ending}", unit): in_unit(values, unit)
        for (ending, unit), part in zip(kinds, parts, strict=False)
        for name, values in zip(names, part, strict=True)
    }


def _errors(frame: CorrectionFrame, goals: Goals, commands: FloatArray, context: Context) -> FloatArray:
    """Root mean square, low and high error of the position [m] and of the stated orientation [rad], (6, n)."""
    predicted = frame.predict(commands, context)
    t = frame.robot.target_names.index(goals.target or frame.robot.target_names[0])
    errors = np.full((6, len(goals)), np.nan)
    given = ~np.isnan(goals.positions)
    spread = predicted.covariance[:, t] * (given[:, :, None] & given[:, None, :])
    left = frame.uncorrected_errors(commands, context)[:, t]
    off = goals.distances(predicted.positions[:, t] + left[:, :3])
    errors[:3] = rms_length(spread, off), *length95(spread, predicted.coverage_factor, off)
    if predicted.turn_covariance is None or goals.asks_for == "position":
        return errors
    turned = _turn_errors(frame, goals, t, commands, context) + left[:, 3:]
    spread = predicted.turn_covariance[:, t]
    if goals.directions is not None:  # rotations about the axis itself do not count
        across = np.eye(3) - goals.directions[:, :, None] * goals.directions[:, None, :]
        spread, turned = across @ spread @ across, np.einsum("nij,nj->ni", across, turned)
    errors[3:] = rms_length(spread, turned), *length95(spread, predicted.coverage_factor, turned)
    return errors


def _turn_errors(frame: CorrectionFrame, goals: Goals, t: int, commands: FloatArray, context: Context) -> FloatArray:
    """Uncorrected rotation vectors of the calibrated robot at the commands, (n, 3) [rad]; zero if it was corrected."""
    if not frame.nothing_to_correct:
        return np.zeros((len(goals), 3))
    rotations = target_poses(frame.robot, frame.robot.assemble(commands, context=context))[1][:, t]
    if goals.rotations is not None:
        return np.array([pin.log3(turn) for turn in rotations @ goals.rotations.swapaxes(1, 2)])
    assert goals.directions is not None
    return np.cross(goals.directions, rotations[:, :, 2])
