"""A result folder as an object, with the names that a fit has: `calib.load_result`; and predictions of either."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calib.core.base.arrays import FloatArray, ReadOnlyArrays
from calib.core.base.errors import DataError
from calib.core.base.other_words import Hinting
from calib.core.base.registry import brought
from calib.core.base.units import error_scale
from calib.core.base.words import titled_html
from calib.core.data.in_memory import PosesLike, as_poses
from calib.core.fitting.estimates import Correlation, Covariance, Estimate, Estimates
from calib.core.fitting.fitted import Fit
from calib.core.judging.promise import Promise
from calib.core.judging.reasons import Code, Verdict
from calib.core.results.report_text import verdict_lines
from calib.core.results.result_reading import joints_used, load, load_promise, load_uncertainty, read_result
from calib.core.robots.held import Holds
from calib.core.robots.loading import RobotLike, as_robot
from calib.core.robots.robot import Robot
from calib.core.robots.terms.term import Context
from calib.core.rows.known_robot import KnownRobot
from calib.core.rows.prediction import ParameterUncertainty, PositionUncertainty


class CalibratedRobot:
    """What has a calibrated robot, and writes it for other programs: a fit, and a loaded result."""

    robot: Robot

    def export(self, path: Path | str, format: str | None = None, *, force: bool = False) -> None:
        """Write the calibrated robot for another program; see `calib.export`.

        Args:
            path: File to write.
            format: `urdf`, `mjcf`, `xacro` and others; by the file's ending if not given.
            force: As in `calib.export`.
        """
        brought("calib.methods", "export")(self.robot, path, format, force=force)


@dataclass(frozen=True, eq=False, repr=False)
class LoadedResult(ReadOnlyArrays, Hinting, CalibratedRobot):
    """A fit that was saved.

    Attributes:
        path: Its folder.
        robot: The calibrated robot.
        parameters: What was found of each parameter, by name.
        content: What `result.json` says, in mm and degrees.
        uncertainty: Uncertainty of the free parameters.
        joints: Joint values of the visits that the fit used, (n, n_actuated) [m or rad].
    """

    _other_words = "a fit"

    path: str
    robot: Robot
    parameters: Estimates
    content: dict[str, Any]
    uncertainty: ParameterUncertainty
    joints: FloatArray

    def __repr__(self) -> str:
        grade, n_poses = self.content["verdict"]["grade"], self.content["n_poses"]
        return f"<result of '{self.robot.name}' in {self.path}: {grade}, {n_poses} poses>"

    def _own_parameters(self) -> list[str]:
        return list(self.parameters)

    def _repr_html_(self) -> str:
        return titled_html(self.robot.name, (repr(self)[1:-1],), self.parameters.rows())

    @property
    def verdict(self) -> Verdict:
        """PASS, CHECK or FAIL, with reasons.

        Raises:
            DataError: `result.json` does not hold it.
        """
        try:
            return Verdict.from_dict(self.content["verdict"])
        except (KeyError, TypeError, ValueError):
            raise DataError(f"{self.path}: the verdict in its result.json cannot be read; run the fit again") from None

    @property
    def rms(self) -> float:
        """Root mean square error after calibration [m; rad or px where no positions are measured].

        At poses that were not used, if there are any; see `calib.core.fitting.fitted.Fit.rms`.
        """
        read = [
            part
            for block in self.content["instruments"]
            for part in self.robot.instrument(block["name"]).parts
            if part.name in {own["name"] for own in block["parts"]}
        ]
        part = next((part for part in read if part.is_position), read[0])
        name = next(name for name in ("validation", "cross_validation", "identification") if name in self.errors)
        shown = self.errors[name]["after"]["rms"]
        return np.nan if shown is None else float(shown) / error_scale(part.dimension)

    @property
    def sigma(self) -> float:
        """Noise of one measured position per axis, as found [m]; of the first kind of rows where none are [SI]."""
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
    def known(self) -> KnownRobot:
        """The robot, with its uncertainty."""
        codes = self.content.get("verdict", {}).get("codes", ())
        return KnownRobot(self.robot, self.uncertainty, self.joints, Code.NOTHING_TO_CORRECT in codes)

    @property
    def promise(self) -> Promise:
        """What its calibration predicts of new readings, for `calib.verify`."""
        return load_promise(self.path, self.robot)

    @property
    def free_names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return tuple(p.name for p, free in zip(self.robot.parameters, self.uncertainty.free, strict=True) if free)

    @property
    def covariance(self) -> Covariance:
        """Covariance of the free parameters, by name."""
        return Covariance(self.free_names, self.uncertainty.covariance)

    @property
    def correlation(self) -> Correlation:
        """Correlation of the free parameters, by name, between -1 and 1."""
        return self.covariance.correlation

    @property
    def errors(self) -> dict[str, dict[str, dict[str, Any]]]:
        """Errors `before` and `after` of the poses that were used and of those that were not, in mm for positions."""
        return dict(self.content["errors"])

    def to_dict(self) -> dict[str, Any]:
        """Return everything that was found, in mm and degrees: the content of `result.json`."""
        return dict(self.content)

    def to_dataframe(self) -> Any:
        """Return all parameters as a pandas table, in the units of tables; pandas missing is an `InputError`."""
        return self.parameters.to_dataframe()

    def held_by(self, holds: Holds) -> tuple[Robot, ParameterUncertainty]:
        """Return the robot for a kind of file (`calib.core.robots.held`), with the uncertainty of its parameters.

        Raises:
            ComputationError: An earlier version wrote the result, and files lose joint terms that it has.
            DataError: The folder has no covariance of this robot.
        """
        robot = self.robot.held_by(holds)
        return robot, load_uncertainty(self.path, robot, holds)

    def predict(self, poses: PosesLike, context: Context | None = None) -> PositionUncertainty:
        """Predict positions with their covariance; see `calib.core.fitting.fitted.Fit.predict`."""
        pose_set = as_poses(self.robot, poses)
        return self.uncertainty.at(self.robot, pose_set.joints, pose_set.conditions if context is None else context)


def load_result(folder: Path | str) -> LoadedResult:
    """Load what `calib fit --out`, or `save`, wrote.

    Args:
        folder: The folder.

    Raises:
        DataError: The folder holds no result, or a damaged one.
        ComputationError: The verdict of the result is FAIL, and it was not forced.
    """
    content, robot = read_result(folder), load(folder)
    rows = zip(content["parameters"], robot.parameters, robot.values, strict=True)
    estimates = {}
    for row, parameter, value in rows:
        per_si = parameter.per_si
        std, low, high = (
            np.nan if row[key] is None else float(row[key]) / per_si for key in ("std", "low95", "high95")
        )
        numbers = parameter.nominal_si, float(value), std, (high - low) / 2
        estimates[parameter.name] = Estimate(
            parameter.name, parameter.unit, *numbers, row["status"], parameter.family, per_si
        )
    known, joints = load_uncertainty(folder, robot), joints_used(folder, robot)
    return LoadedResult(str(folder), robot, Estimates(estimates), content, known, joints)


def predict(calibrated: RobotLike | Fit | LoadedResult, poses: PosesLike) -> PositionUncertainty:
    """Predict positions of all targets, loops closed.

    Args:
        calibrated: A fit or a loaded result. Or a robot alone: then the covariance is NaN.
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
