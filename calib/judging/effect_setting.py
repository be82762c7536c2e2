"""What effects that a model may leave out are made of: the fit's rows, and when each visit was made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.base.arrays import FloatArray, IntArray
from calib.base.units import Dimension
from calib.data.measurements import Measurements, Poses
from calib.numerics.variance_components import SharedError
from calib.robots.robot import Configurations, Robot
from calib.rows.observed import Observed
from calib.rows.rows import Scales
from calib.rows.whitening import Whitening


@dataclass(frozen=True, eq=False)
class EffectSetting:
    """What effects are made of.

    Attributes:
        robot: The calibrated robot.
        data: Its measurements.
        configurations: Its assembled visits.
        observed: The measurements compared with the robot, with derivatives by the joints.
        whitening: What whitened the rows.
        scales: What was assumed of the noise.
        weights: Of each reading, (n_readings,).
    """

    robot: Robot
    data: Measurements
    configurations: Configurations
    observed: Mapping[str, Observed]
    whitening: Whitening
    scales: Scales
    weights: FloatArray

    def whitened(self, arrays: Mapping[str, FloatArray]) -> FloatArray:
        """Return what effects do to the rows of each instrument, (n, n_rows, k) [SI], as whitened rows, (n_all, k)."""
        rows: FloatArray = self.whitening.flatten(arrays) / self.whitening.row_scale(self.scales.groups)[:, None]
        if self._weighing is not None:
            rows = self._weighing.whiten(rows)
        return np.sqrt(self.weights)[self.whitening.layout.reading][:, None] * rows

    @cached_property
    def _weighing(self) -> SharedError | None:
        return self.whitening.weighing(self.scales.ratios)

    def size(self, rows: FloatArray) -> float:
        """Return the root mean square of whitened rows (n_rows,) over the readings of `dimension` [SI]."""
        layout, whole = self.whitening.layout, rows if self._weighing is None else self._weighing.unwhiten(rows)
        of_first = layout.group == self._first
        squares = (whole[of_first] * self.metre) ** 2
        return float(np.sqrt(np.sum(squares) / len(np.unique(layout.reading[of_first]))))

    def per_visit(self, values: FloatArray) -> FloatArray:
        """Return values of the visits, (n_visits, ...), for each row."""
        return values[self.visit]

    @cached_property
    def visit(self) -> IntArray:
        """Visit of each row, (n_rows,)."""
        layout = self.whitening.layout
        return layout.visit[layout.reading]

    @cached_property
    def course(self) -> FloatArray:
        """When each visit was made, (n_visits,): by the time, where all have it, else by the order of the rows."""
        return course(self.data)

    @property
    def metre(self) -> float:
        """What a whitened row of a position is in metres; of the first kind of rows where no positions are."""
        return float(self.scales.groups[self._first] * self.whitening.groups[self._first].typical)

    @property
    def dimension(self) -> Dimension:
        """What `metre` measures."""
        return self.whitening.groups[self._first].dimension

    @property
    def _first(self) -> int:
        return next((g for g, group in enumerate(self.whitening.groups) if group.is_position), 0)


def has_time(data: Poses) -> bool:
    """Return whether the data say when each visit was made."""
    time = data.context.get("time")
    return time is not None and bool(np.all(np.isfinite(time))) and float(np.ptp(time)) > 0


def course(data: Measurements) -> FloatArray:
    """Return when each visit was made, (n,): by the time [s], where all have it, else by the order of the rows."""
    return np.asarray(data.context["time"] if has_time(data) else data.places, dtype=float)
