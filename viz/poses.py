"""The data of each measured point: commanded, measured and predicted positions, with their uncertainty."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Self

import numpy as np

from calib import Robot
from calib.core.base.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays
from calib.core.rows.prediction import PositionUncertainty

IDENTIFICATION, VALIDATION, MEASURED, EXCLUDED = "identification", "validation", "measured", "left out"
PLANNED, COLLIDES = "planned", "collides"
GROUPS = (IDENTIFICATION, VALIDATION, MEASURED, EXCLUDED, PLANNED, COLLIDES)
WORST = 1000
"""Rows with the largest errors of each state, which are always in a page."""
_MOST_ROWS = 20_000  # in one page, about 9 MB; more cannot be told apart on a screen


@dataclass(frozen=True, eq=False)
class PredictingRobot:
    """A calibrated robot and the uncertainty of its positions.

    Attributes:
        robot: The robot.
        predict: Predicts positions with their covariance, at actuated joints (n, n_actuated), under conditions if any.
    """

    robot: Robot
    predict: Callable[..., PositionUncertainty]


@dataclass(frozen=True, eq=False)
class RowTable(ReadOnlyArrays):
    """A table of which every array and every tuple has an entry for each row; labels among them."""

    def __len__(self) -> int:
        return len(self._columns()["labels"])

    def _columns(self) -> dict[str, Any]:
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value for name, value in values.items() if isinstance(value, (np.ndarray, tuple))}

    def subset(self, rows: IntArray | BoolArray) -> Self:
        """Return the rows with these numbers (n,), in this order, or those of a mask."""
        chosen = np.arange(len(self))[rows]
        return replace(
            self,
            **{
                name: values[chosen] if isinstance(values, np.ndarray) else tuple(values[k] for k in chosen)
                for name, values in self._columns().items()
            },
        )

    def followed_by(self, others: Sequence[Self]) -> Self:
        """Return this table with the rows of others behind its own."""
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
    """One row per pose and measured point. Positions are in the measurement frame; NaN where not known, such as where
    no instrument measured points. Arrays are read-only.

    Attributes:
        joints: Actuated joints, (n, n_actuated) [m or rad].
        measured: Measured positions, (n, 3) [m].
        before, after: Predicted positions of the robot before and after calibration, (n, 3) [m].
        sigma: Standard deviation of each measured coordinate, which is a mean over the readings of its pose, (n,) [m].
        spread: Standard deviation of the predicted position after calibration, (n, 3) [m].
        group: `identification`, `validation`, `measured` (not part of a fit) or `left out` (of it, as an outlier);
            `planned`, or `collides` where the robot hits something, of poses where nothing was read.
        outlier: Which rows are outliers, (n,).
        labels: Name of each pose.
        targets: Name of the measured point of each row: of the instrument that measured it.
        readings: How many readings each measured position is a mean of, (n,).
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
        predicted: FloatArray = {"before": self.before, "after": self.after}[state]
        return predicted - self.measured

    def sigma_of_reading(self) -> FloatArray:
        """Return the standard deviation of one reading of each row, per axis, (n,) [m]; NaN where not known."""
        sigma: FloatArray = self.sigma * np.sqrt(self.readings)
        return sigma

    def normalised_residuals(self) -> FloatArray:
        """Return the residuals after calibration, which are of means, divided by the sigma of these means, (n, 3).

        NaN where sigma is zero or unknown.
        """
        sigma = np.where(self.sigma > 0, self.sigma, np.nan)
        ratio: FloatArray = self.error("after") / sigma[:, None]
        return ratio


def rows_shown(table: PoseTable) -> IntArray:
    """Return the rows that the page holds, ascending, (n,): all, or those that matter and others evenly spread."""
    return spread_rows(table.outlier, [np.linalg.norm(table.error(state), axis=1) for state in ("before", "after")])


def spread_rows(outlier: BoolArray, sizes: list[FloatArray]) -> IntArray:
    """Return the rows that a page holds, ascending: all, or outliers, the largest errors, and others evenly spread.

    Args:
        outlier: Which rows are outliers, (n,).
        sizes: How large the errors of each state are, (n,); NaN where not known.
    """
    n = len(outlier)
    if n <= _MOST_ROWS:
        return np.arange(n)
    first = outlier.copy()
    for lengths in sizes:
        first[np.argsort(-np.nan_to_num(lengths, nan=-1.0), kind="stable")[:WORST]] = True
    matter, others = np.flatnonzero(first), np.flatnonzero(~first)
    matter = _evenly_spread(matter, min(len(matter), _MOST_ROWS // 2))
    return np.union1d(matter, _evenly_spread(others, min(len(others), _MOST_ROWS - len(matter)))).astype(np.intp)


def _evenly_spread(rows: IntArray, count: int) -> IntArray:
    """`count` of some rows (n,), evenly spread."""
    return rows[np.arange(count) * len(rows) // max(count, 1)]


def average_poses(table: PoseTable) -> PoseTable:
    """Return one row for each point of a pose: the mean of its readings, the rows of `table`.

    Places are counted anew, so that repeats leave no gaps between the poses.
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
    """A number for each key, the same for equal ones, counted as they first appear."""
    numbers: dict[Hashable, int] = {}
    return np.array([numbers.setdefault(key, len(numbers)) for key in keys], dtype=np.intp)


def _places(table: PoseTable) -> IntArray:
    """The place of the pose of each row among the poses of its series: where it was first measured counts."""
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
