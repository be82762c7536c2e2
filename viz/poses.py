"""The data of each measured point: joints, measured and predicted positions, and their uncertainty."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Self

import numpy as np

from calib import Robot
from calib.core.base.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays, evenly_spread
from calib.core.rows.prediction import PositionUncertainty

IDENTIFICATION, VALIDATION, MEASURED, EXCLUDED = "identification", "validation", "measured", "left out"
PLANNED, COLLIDES = "planned", "collides"
GROUPS = (IDENTIFICATION, VALIDATION, MEASURED, EXCLUDED, PLANNED, COLLIDES)
WORST = 1000
"""Number of rows with the largest errors of each state that a page always has."""
_MOST_ROWS = 20_000  # rows of a page, about 9 MB; more do not show on a screen


@dataclass(frozen=True, eq=False)
class PredictingRobot:
    """A calibrated robot and the uncertainty of its positions.

    Attributes:
        robot: The robot.
        predict: Predicts positions with covariance from actuated joints (n, n_actuated) and, if given, conditions.
    """

    robot: Robot
    predict: Callable[..., PositionUncertainty]


@dataclass(frozen=True, eq=False)
class RowTable(ReadOnlyArrays):
    """A table whose arrays and tuples have an entry for each row; `labels` is one of them."""

    def __len__(self) -> int:
        return len(self._columns()["labels"])

    def _columns(self) -> dict[str, Any]:
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value for name, value in values.items() if isinstance(value, (np.ndarray, tuple))}

    def subset(self, rows: IntArray | BoolArray) -> Self:
        """Return the rows with these indices (n,), in this order, or the rows of a mask."""
        chosen = np.arange(len(self))[rows]
        return replace(
            self,
            **{
                name: values[chosen] if isinstance(values, np.ndarray) else tuple(values[k] for k in chosen)
                for name, values in self._columns().items()
            },
        )

    def followed_by(self, others: Sequence[Self]) -> Self:
        """Return this table followed by the rows of other tables."""
        every = [table._columns() for table in (self, *others)]
        return replace(
            self,
            **{
                name: np.concatenate(parts) if isinstance(parts[0], np.ndarray) else sum(parts, ())
                for name in every[0]
                if (parts := [columns[name] for columns in every])
            },
        )


@dataclass(frozen=True, eq=False)
class PoseTable(RowTable):
    """One row per pose and measured point. Positions are in the measurement frame; NaN where unknown, such as without
    a measured point.

    Attributes:
        joints: Actuated joints, (n, n_actuated) [m or rad].
        measured: Measured positions, (n, 3) [m].
        before, after: Predicted positions of the robot before and after calibration, (n, 3) [m].
        sigma: Standard deviation of each measured coordinate, a mean over the readings of its pose, (n,) [m].
        spread: Standard deviation of the predicted position after calibration, (n, 3) [m].
        group: `identification`, `validation`, `measured` (not part of a fit) or `left out` (excluded as an outlier);
            for poses without readings `planned`, or `collides` if the robot hits something.
        outlier: Mask of outliers, (n,).
        labels: Name of each pose.
        targets: Name of each row's measured point, or of its instrument.
        readings: Number of readings of which each measured position is a mean, (n,).
        series: Series of each row, measured in one go: a file, or a set of poses.
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

    def error(self, state: str) -> FloatArray:
        """Return predicted minus measured positions `before` or `after` calibration, (n, 3) [m]."""
        return np.asarray(getattr(self, state) - self.measured)

    def sigma_of_reading(self) -> FloatArray:
        """Return the standard deviation of one reading of each row, per axis, (n,) [m]; NaN where unknown."""
        return np.asarray(self.sigma * np.sqrt(self.readings))

    def normalised_residuals(self) -> FloatArray:
        """Return the residuals after calibration over their sigma, both of means, (n, 3); NaN without a sigma."""
        sigma = np.where(self.sigma > 0, self.sigma, np.nan)
        return np.asarray(self.error("after") / sigma[:, None])


def rows_shown(table: PoseTable) -> IntArray:
    """Return the rows of a page, ascending, (n,); see `spread_rows`."""
    return spread_rows(table.outlier, [np.linalg.norm(table.error(state), axis=1) for state in ("before", "after")])


def spread_rows(outlier: BoolArray, sizes: list[FloatArray]) -> IntArray:
    """Return the rows of a page, ascending, (n,).

    These are all rows. If there are too many, they are outliers (n,), the largest errors, by the sizes of each state
    (n,), and others evenly spread.
    """
    n = len(outlier)
    if n <= _MOST_ROWS:
        return np.arange(n)
    first = outlier.copy()
    for lengths in sizes:
        first[np.argsort(-np.nan_to_num(lengths, nan=-1.0), kind="stable")[:WORST]] = True
    matter, others = np.flatnonzero(first), np.flatnonzero(~first)
    matter = matter[evenly_spread(len(matter), _MOST_ROWS // 2)]
    return np.union1d(matter, others[evenly_spread(len(others), _MOST_ROWS - len(matter))]).astype(np.intp)


def average_poses(table: PoseTable) -> PoseTable:
    """Return one row for each point of a pose: the mean of its readings, the rows of `table`.

    Places are renumbered without gaps between the poses.
    """
    numbers = _number_keys(zip(table.series, table.group, table.labels, table.targets, strict=True))
    _, first, count = np.unique(numbers, return_index=True, return_counts=True)

    def mean(values: FloatArray) -> FloatArray:
        total = np.zeros((len(first), *values.shape[1:]))
        np.add.at(total, numbers, values)
        result: FloatArray = (total.T / count).T
        return result

    outlier = np.zeros(len(first), dtype=bool)
    np.logical_or.at(outlier, numbers, table.outlier)
    return replace(
        table.subset(first),
        joints=mean(table.joints),
        measured=mean(table.measured),
        before=mean(table.before),
        after=mean(table.after),
        sigma=mean(table.sigma) / np.sqrt(count),
        spread=mean(table.spread),
        outlier=outlier,
        readings=count.astype(np.intp),
        place=_places(table)[first],
    )


def _number_keys(keys: Iterable[Hashable]) -> IntArray:
    """A number for each key, equal for equal keys, in the order of first appearance."""
    numbers: dict[Hashable, int] = {}
    return np.array([numbers.setdefault(key, len(numbers)) for key in keys], dtype=np.intp)


def _places(table: PoseTable) -> IntArray:
    """The place of each row's pose among the poses of its series, by its first measurement."""
    pose = _number_keys(zip(table.series, table.labels, strict=True))
    first = np.full(int(pose.max(initial=-1)) + 1, np.iinfo(np.intp).max)
    np.minimum.at(first, pose, table.place)
    series = np.array(_number_keys(table.series))
    result = np.zeros(len(table), dtype=np.intp)
    for number in np.unique(series):
        rows = series == number
        result[rows] = np.unique(first[pose[rows]], return_inverse=True)[1].reshape(-1)
    return result


def empty(robot: Robot) -> PoseTable:
    """Return a table without rows."""
    points = np.empty((0, 3))
    joints = np.empty((0, len(robot.joint_names)))
    whole = np.empty(0, dtype=np.intp)
    return PoseTable(
        joints, points, points, points, np.empty(0), points, (), np.empty(0, dtype=bool), (), (), whole, (), whole
    )
