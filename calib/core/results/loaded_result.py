"""A result folder as an object with the same names as a fit; and predictions of either."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import DataError
from calib.core.base.other_words import HintedObject
from calib.core.base.registry import load_entry
from calib.core.base.units import ERROR_UNIT, in_unit
from calib.core.base.words import count_noun, html_with_title, listing
from calib.core.data.in_memory import PosesLike, as_poses
from calib.core.data.measurements import Poses
from calib.core.fitting.error_sets import ErrorSet
from calib.core.fitting.estimates import Correlation, Covariance, Estimates
from calib.core.fitting.fitted import Fit
from calib.core.fitting.terms.joint_curves import is_beyond_learned
from calib.core.judging.promise import Promise
from calib.core.judging.reasons import Code, Verdict
from calib.core.judging.verdict import JudgedFit
from calib.core.results.report_text import verdict_lines
from calib.core.results.saved_fit import evaluate_fit
from calib.core.robots.accuracy_of_files import Holds
from calib.core.robots.loading import RobotLike, as_robot
from calib.core.robots.robot import Robot
from calib.core.robots.terms.term import Context
from calib.core.rows.frames import KnownRobot, ReportedUncertainty
from calib.core.rows.prediction import ParameterUncertainty, PositionUncertainty

_DIGITS = 9  # decimals to which joint values and readings of two files are compared [SI]


class CalibratedRobot:
    """Base of objects with a calibrated robot that write it for other programs: a fit, and a loaded result."""

    robot: Robot

    def export(self, path: Path | str, format: str | None = None, *, force: bool = False) -> None:
        """Write the calibrated robot for another program into a file; see `calib.export`.

        `format` is `urdf`, `mjcf`, `xacro` or another one; by the file's ending if not given.
        """
        load_entry("calib.methods", "export")(self.robot, path, format, force=force)


@dataclass(frozen=True, eq=False, repr=False)
class LoadedResult(HintedObject, CalibratedRobot):
    """A saved fit.

    Attributes:
        nominal: The robot as described to the fit.
        content: Content of its `result.json`, in mm and degrees, as the fit wrote it.
        saved: The saved fit of the folder (`calib.core.results.saved_fit`).
    """

    _other_words = "a fit"

    path: str
    nominal: Robot
    robot: Robot
    content: dict[str, Any]
    saved: Mapping[str, Any]

    def __repr__(self) -> str:
        grade, n_poses = self.content["verdict"]["grade"], self.content["n_poses"]
        return f"<result of '{self.robot.name}' in {self.path}: {grade}, {n_poses} poses>"

    def _own_parameters(self) -> list[str]:
        return list(self.parameters)

    def _repr_html_(self) -> str:
        return html_with_title(self.robot.name, (repr(self)[1:-1],), self.parameters.rows())

    @cached_property
    def fit(self) -> JudgedFit:
        """The fit: its model evaluated at the saved values, with its measurements.

        Raises:
            ComputationError: The fit cannot be restored from the folder.
            DataError: An earlier version wrote the folder, without measurements.
        """
        return evaluate_fit(self.nominal, self.saved["fit"], self.path)

    @property
    def parameters(self) -> Estimates:
        """Estimates of the parameters by name."""
        return self.fit.parameters

    @property
    def uncertainty(self) -> ParameterUncertainty:
        """Uncertainty of the free parameters."""
        return self.fit.uncertainty

    @property
    def joints(self) -> FloatArray:
        """Joint values of the used visits, (n, n_actuated) [m or rad]."""
        return self.fit.identification.data.joints

    @property
    def verdict(self) -> Verdict:
        """PASS, CHECK or FAIL, with reasons, as in the fit; `DataError` if the folder does not hold it."""
        try:
            return Verdict.from_dict(self.content["verdict"])
        except (KeyError, TypeError, ValueError):
            raise DataError(f"{self.path}: its verdict cannot be read; run the fit again") from None

    @property
    def rms(self) -> float:
        """Root mean square error after calibration, as `Fit.rms` [m; rad or px where no positions are measured]."""
        return self.fit.rms

    @property
    def sigma(self) -> float:
        """Found noise of one measured position per axis [m]; if none is measured, of the first kind of rows [SI]."""
        sigma = self.content["sigma"]
        return np.nan if sigma is None else float(sigma)

    @property
    def converged(self) -> bool:
        """Whether the fit ended at a minimum."""
        return bool(self.content["converged"])

    def summary(self) -> str:
        """Return the verdict with its reasons, as text."""
        return "\n".join([f"Calibration of {self.robot.name} ({self.path})", *verdict_lines(self.verdict)])

    @property
    def known_robot(self) -> KnownRobot:
        """The robot, with its uncertainty."""
        codes = self.content["verdict"].get("codes", ())
        return KnownRobot(self.robot, self.uncertainty, self.joints, Code.NOTHING_TO_CORRECT in codes)

    @property
    def promise(self) -> Promise:
        """Predictions of the calibration for new readings, for `calib.verify`."""
        return Promise.from_calibration(self.fit)

    @property
    def reported_uncertainty(self) -> ReportedUncertainty:
        """Uncertainty of positions, in the frame in which it is reported."""
        return ReportedUncertainty.from_robot(self.robot, self.uncertainty, self.joints)

    @property
    def free_names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return tuple(p.name for p, free in zip(self.robot.parameters, self.uncertainty.free, strict=True) if free)

    @property
    def covariance(self) -> Covariance:
        """Covariance of the free parameters, by name."""
        return self.fit.covariance

    @property
    def correlation(self) -> Correlation:
        """Correlation of the free parameters, by name, between -1 and 1."""
        return self.covariance.correlation

    @property
    def errors(self) -> dict[str, dict[str, dict[str, Any]]]:
        """Errors `before` and `after` at used and unused poses, in mm for positions."""
        return dict(self.content["errors"])

    def to_dict(self) -> dict[str, Any]:
        """Return the content of `result.json`, in mm and degrees."""
        return dict(self.content)

    def to_dataframe(self) -> Any:
        """Return all parameters as a pandas table, in the units of tables; pandas missing is an `InputError`."""
        return self.parameters.to_dataframe()

    def held_by(self, holds: Holds) -> tuple[Robot, ParameterUncertainty]:
        """Return the robot for a kind of file (`calib.core.robots.accuracy_of_files`), with its uncertainty.

        Raises:
            ComputationError: An earlier version wrote the result, and files of this kind lose its joint terms.
            DataError: The folder has no covariance of this robot.
        """
        robot = self.robot.held_by(holds)
        return robot, self._uncertainty_of(robot)

    def _uncertainty_of(self, robot: Robot) -> ParameterUncertainty:
        if np.array_equal(robot.values, self.robot.values):
            return self.uncertainty
        for entry in self.saved["fit"]["reduced"].values():
            if np.array_equal(robot.values, entry["values"]):
                return evaluate_fit(self.nominal, entry, self.path).uncertainty
        raise DataError(f"{self.path}: does not hold the robot's covariance for this format; choose another format")

    def readings(self) -> dict[str, dict[bytes, float]]:
        """Return the squared errors of the readings of each set, by their keys (`reading_keys`).

        Errors are those of the first part of the first instrument, in its unit of errors; NaN for readings without it.
        """
        sets = {"identification": self.fit.identification, "validation": self.fit.validation}
        return {name: _squared_errors(errors) for name, errors in sets.items() if errors is not None}

    def predict(self, poses: PosesLike, context: Context | None = None) -> PositionUncertainty:
        """Predict positions with their covariance; see `calib.core.fitting.fitted.Fit.predict`."""
        pose_set = as_poses(self.robot, poses)
        return self.uncertainty.predict(
            self.robot, pose_set.joints, pose_set.conditions if context is None else context
        )

    def remarks_beyond_curves(self, poses: Poses) -> list[str]:
        """Return a remark on poses that lie where no error curve of a joint was learned."""
        outside = is_beyond_learned(self.robot, self.joints, poses.joints)
        beyond = np.flatnonzero(np.any(outside, axis=1))
        if not len(beyond):
            return []
        joints = [self.robot.joint_names[j] for j in np.flatnonzero(np.any(outside, axis=0))]
        return [
            f"{count_noun(len(beyond), 'pose lies', 'poses lie')} where no error curve of {listing(joints)} was learned"
            f" ({listing([poses.labels[k] for k in beyond])}): there the error is as uncertain as before measuring"
        ]


def reading_keys(instrument: str, joints: FloatArray, values: FloatArray) -> list[bytes]:
    """Return a key of each reading of an instrument, equal for equal readings.

    The readings are joint values (n, n_actuated) [m or rad] and what was read, (n, n_values).
    """
    numbers = np.round(np.hstack([joints, values]), _DIGITS) + 0.0  # no -0.0
    return [instrument.encode() + row.tobytes() for row in np.where(np.isnan(numbers), np.nan, numbers)]


def _squared_errors(errors: ErrorSet) -> dict[bytes, float]:
    first, data, result = errors.parts()[0][1], errors.data, dict[bytes, float]()
    same = [part for part in errors.parts() if (part[1].name, part[1].dimension) == (first.name, first.dimension)]
    rows_of = {instrument.name: rows for instrument, _, rows in same}
    for name, readings in data.readings.items():
        squares = np.full(len(readings), np.nan)
        if name in rows_of:
            shown = in_unit(errors.after[name][:, rows_of[name]], ERROR_UNIT[first.dimension])
            squares = np.nansum(shown**2, axis=1)
        keys = reading_keys(name, data.joints[readings.visits], readings.values)
        result |= dict(zip(keys, squares.tolist(), strict=True))
    return result


def predict(calibrated: RobotLike | Fit | LoadedResult, poses: PosesLike) -> PositionUncertainty:
    """Predict positions of all targets, loops closed.

    Args:
        calibrated: A fit, a loaded result, or a robot alone, whose covariance is NaN.
        poses: Poses, with their conditions (load, temperature, time); or actuated joints alone, (n, n_actuated)
            [m or rad].

    Raises:
        DataError: Joint values of the wrong shape.
        UnreachablePoseError: A loop stays open.
    """
    if isinstance(calibrated, (Fit, LoadedResult)):
        return calibrated.predict(poses)
    robot = as_robot(calibrated)
    pose_set = as_poses(robot, poses)
    positions = robot.positions(pose_set.joints, pose_set.conditions)
    return PositionUncertainty(positions, np.full((*positions.shape, 3), np.nan), np.nan)
