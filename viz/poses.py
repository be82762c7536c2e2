"""What is known about each measured point: where it was commanded, measured and predicted, and how sure that is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from calib import Fit, Measurements, Robot
from calib.data.tables import Table, read_table
from calib.errors import DataError
from calib.identification.fitted import ErrorSet
from calib.linearisation.prediction import PositionUncertainty
from calib.model.mechanism import BoolArray, FloatArray, IntArray
from calib.numerics.outliers import Outlier
from calib.read_only import ReadOnlyArrays
from calib.reporting.results import read_result

IDENTIFICATION, VALIDATION, MEASURED, EXCLUDED = "identification", "validation", "measured", "left out"
GROUPS = (IDENTIFICATION, VALIDATION, MEASURED, EXCLUDED)


@dataclass(frozen=True, eq=False)
class Calibrated:
    """A calibrated robot and how sure its positions are.

    Attributes:
        robot: The robot.
        predict: Predicts positions at actuated joints (n, n_actuated), with their covariance.
    """

    robot: Robot
    predict: Callable[[FloatArray], PositionUncertainty]


@dataclass(frozen=True, eq=False)
class PoseTable(ReadOnlyArrays):
    """One row per pose and target. Positions are in the measurement frame; NaN where not known. Arrays are read-only.

    Attributes:
        joints: Actuated joints, (n, n_actuated) [m or rad].
        measured: Measured positions, (n, 3) [m].
        before, after: Predicted positions of the robot before and after calibration, (n, 3) [m].
        sigma: Standard deviation of each measured coordinate, which is a mean over the readings of its pose, (n,) [m].
        spread: Standard deviation of the predicted position after calibration, (n, 3) [m].
        group: `identification`, `validation`, `measured` (not part of a fit) or `left out` (of it, as an outlier).
        outlier: Which rows are outliers, (n,).
        labels: What to call each pose.
        targets: Name of the measured point of each row.
        readings: How many readings each measured position is a mean of, (n,).
        series: What was measured in one go with each row: a file, or a set of poses.
        place: Place of each row's pose in the order of measurement of its series, (n,).
    """

    joints: FloatArray
    measured: FloatArray
    before: FloatArray
    after: FloatArray
    sigma: FloatArray
    spread: FloatArray
    group: tuple[str, ...]
    outlier: BoolArray
    labels: tuple[str, ...]
    targets: tuple[str, ...]
    readings: IntArray
    series: tuple[str, ...]
    place: IntArray

    def __post_init__(self) -> None:
        n = len(self.labels)
        shapes = {
            "measured": (n, 3),
            "before": (n, 3),
            "after": (n, 3),
            "sigma": (n,),
            "spread": (n, 3),
            "outlier": (n,),
            "readings": (n,),
            "place": (n,),
        }
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise DataError(f"pose table: '{name}' has shape {getattr(self, name).shape}, expected {shape}")
        if self.joints.ndim != 2 or {len(self.joints), len(self.group), len(self.targets), len(self.series)} != {n}:
            raise DataError(f"pose table: joints, groups, targets and series must have {n} rows, one for each label")
        unknown = sorted(set(self.group) - set(GROUPS))
        if unknown:
            raise DataError(f"pose table: unknown group '{unknown[0]}'; valid: {', '.join(GROUPS)}")
        super().__post_init__()

    def __len__(self) -> int:
        return len(self.labels)

    def error(self, state: str) -> FloatArray:
        """Return predicted minus measured positions `before` or `after` calibration, (n, 3) [m]."""
        predicted: FloatArray = {"before": self.before, "after": self.after}[state]
        return predicted - self.measured

    def sigma_of_reading(self) -> FloatArray:
        """Return the standard deviation of one reading of each row, per axis, (n,) [m]; NaN where not known."""
        sigma: FloatArray = self.sigma * np.sqrt(self.readings)
        return sigma

    def over_sigma(self) -> FloatArray:
        """Return the residuals after calibration, which are of means, divided by the sigma of these means, (n, 3).

        NaN where sigma is zero or unknown.
        """
        sigma = np.where(self.sigma > 0, self.sigma, np.nan)
        ratio: FloatArray = self.error("after") / sigma[:, None]
        return ratio


def from_fit(fit: Fit) -> PoseTable:
    """Return the poses of a fit, identification first, outliers that were left out last."""
    parts = [_judged(fit, IDENTIFICATION, fit.identification, fit.identification_uncertainty, fit.outliers)]
    if fit.validation is not None and fit.validation_uncertainty is not None:
        parts.append(_judged(fit, VALIDATION, fit.validation, fit.validation_uncertainty, fit.validation_outliers))
    if fit.with_all is not None and fit.excluded:
        rows = np.array(sorted({outlier.pose for outlier in fit.excluded}), dtype=np.intp)
        data = fit.with_all.identification.data.subset(rows)
        found = fit.uncertainty(data.joints)
        sigma = fit.statistics.sigma / np.sqrt(data.counts)
        before = fit.placed.positions(data.joints)
        left_out = _table(fit.robot, data, EXCLUDED, before, found.positions, sigma, found.std)
        parts.append(replace(left_out, outlier=np.ones(len(left_out), dtype=bool)))
    if fit.validation is not None and not _measured_together(fit.identification.data, fit.validation.data):
        sets = (IDENTIFICATION, VALIDATION, IDENTIFICATION)  # left out: of those to identify with
        parts = [
            replace(part, series=(f"{part.series[0]} ({name})",) * len(part))
            for part, name in zip(parts, sets, strict=False)
        ]
    return concatenate(parts)


def _measured_together(first: Measurements, second: Measurements) -> bool:
    """Whether two sets are parts of one file, so that their places are of one order."""
    return first.path == second.path and not np.intersect1d(first.places, second.places).size


def _judged(
    fit: Fit, group: str, found: ErrorSet, uncertainty: PositionUncertainty, outliers: tuple[Outlier, ...]
) -> PoseTable:
    sigma = fit.statistics.sigma / np.sqrt(found.data.counts)
    measured = found.data.positions
    table = _table(
        fit.robot, found.data, group, measured + found.before, measured + found.after, sigma, uncertainty.std
    )
    marked = np.zeros(found.after.shape[:2], dtype=bool)
    for outlier in outliers:
        marked[outlier.pose, fit.robot.target_names.index(outlier.target)] = True
    return replace(table, outlier=marked.ravel())


def from_measurements(data: Measurements, nominal: Robot, calibrated: Calibrated | None, sigma: float) -> PoseTable:
    """Return measurements with what a robot predicts for them.

    Args:
        data: The measurements.
        nominal: The robot before calibration.
        calibrated: The robot after it and how sure it is, or None.
        sigma: Standard deviation of one reading per axis [m]; NaN if not known.

    Raises:
        UnreachablePoseError: A pose cannot be assembled.
    """
    before = nominal.positions(data.joints)
    after, spread = np.full_like(before, np.nan), np.full_like(before, np.nan)
    if calibrated is not None:
        found = calibrated.predict(data.joints)
        after, spread = found.positions, found.std
    return _table(nominal, data, MEASURED, before, after, sigma / np.sqrt(data.counts), spread)


def _table(
    robot: Robot,
    data: Measurements,
    group: str,
    before: FloatArray,
    after: FloatArray,
    sigma: FloatArray,
    spread: FloatArray,
) -> PoseTable:
    """Turn arrays (n_poses, n_targets, 3) into rows."""
    n_targets = len(robot.target_names)
    n = len(data) * n_targets
    return PoseTable(
        joints=np.repeat(data.joints, n_targets, axis=0),
        measured=data.positions.reshape(n, 3),
        before=before.reshape(n, 3),
        after=after.reshape(n, 3),
        sigma=np.repeat(sigma, n_targets),
        spread=spread.reshape(n, 3),
        group=(group,) * n,
        outlier=np.zeros(n, dtype=bool),
        labels=tuple(name for name in data.names for _ in range(n_targets)),
        targets=robot.target_names * len(data),
        readings=np.repeat(data.counts, n_targets),
        series=(data.path,) * n,
        place=np.repeat(data.places, n_targets),
    )


def from_result(folder: Path | str, calibrated: Calibrated) -> PoseTable:
    """Return the poses that a result folder holds: its `residuals.csv`, with the outliers of its `result.json`.

    Raises:
        DataError: A file is missing, broken, or belongs to another robot.
    """
    robot = calibrated.robot
    path = Path(folder) / "residuals.csv"
    table, content = read_table(path), read_result(folder)
    for name in ("set", "pose", "target", "readings"):
        if name not in table.names:
            raise DataError(f"{path}: no column '{name}'; run the fit again")
    joints = np.stack([table.column(name, robot.mechanism.dimensions[name]) for name in robot.joint_names], axis=1)
    measured, before, after = (_vectors(table, prefix) for prefix in ("measured", "error_before", "error_after"))
    places = list(zip(table.text("set"), table.text("pose"), table.text("target"), strict=True))
    outliers = {(row["set"], row["pose"], row["target"]) for row in content["outliers"]}
    target = np.array([robot.target_names.index(name) for _, _, name in places])
    readings = np.array([int(cell) for cell in table.text("readings")], dtype=np.intp)
    return PoseTable(
        joints=joints,
        measured=measured,
        before=measured + before,
        after=measured + after,
        sigma=float(content["sigma"]) / np.sqrt(readings),
        spread=calibrated.predict(joints).std[np.arange(len(places)), target],
        group=tuple(group for group, _, _ in places),
        outlier=np.array([place in outliers for place in places], dtype=bool),
        labels=tuple(label for _, label, _ in places),
        targets=tuple(name for _, _, name in places),
        readings=readings,
        series=tuple(group for group, _, _ in places),
        place=np.arange(len(places)) // len(robot.target_names),
    )


def _vectors(table: Table, prefix: str) -> FloatArray:
    return np.stack([table.column(f"{prefix}_{axis}", "length") for axis in "xyz"], axis=1)


def concatenate(parts: list[PoseTable]) -> PoseTable:
    """Return one table of several, in this order."""
    merged: dict[str, object] = {}
    for field in fields(PoseTable):
        values = [getattr(part, field.name) for part in parts]
        merged[field.name] = np.concatenate(values) if isinstance(values[0], np.ndarray) else sum(values, ())
    return PoseTable(**merged)  # type: ignore[arg-type]


def empty(robot: Robot) -> PoseTable:
    """Return a table without rows."""
    points = np.empty((0, 3))
    joints = np.empty((0, len(robot.joint_names)))
    whole = np.empty(0, dtype=np.intp)
    return PoseTable(
        joints, points, points, points, np.empty(0), points, (), np.empty(0, dtype=bool), (), (), whole, (), whole
    )
