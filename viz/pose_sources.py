"""Pose tables of fits, result folders and measurements.

A reading of a point has a row. If no instrument of a set measures points, every pose has a row for each target of the
robot, with its predicted position and nothing measured.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from calib import Fit, Measurements, Robot
from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.memoize import memoize
from calib.core.data.measurements import Poses
from calib.core.fitting.error_sets import STATES, ErrorSet
from calib.core.fitting.outliers import numbers_by_instrument
from calib.core.instruments.kind import FrameInstrument, Instrument
from calib.core.judging import findings
from calib.core.rows.observed import observe
from calib.core.rows.prediction import PositionUncertainty
from viz.poses import (
    COLLIDES,
    EXCLUDED,
    IDENTIFICATION,
    MEASURED,
    PLANNED,
    VALIDATION,
    PoseTable,
    PredictingRobot,
    average_poses,
)

Sigmas = Mapping[str, float]
"""Noise of point measurements per axis [m], by instrument; missing where unknown."""


@dataclass(frozen=True, eq=False)
class ShownSet:
    """Measurements of one group of a pose table.

    Attributes:
        errors: The measurements, with the errors of the robots before and after calibration.
        placed: The robot before calibration.
        predictions: Positions that the calibrated robot predicts at each visit; None if there is no such robot.
        sigmas: Noise.
        outliers: Indices of outlying readings, by instrument.
    """

    group: str
    errors: ErrorSet
    placed: Robot
    predictions: PositionUncertainty | None
    sigmas: Sigmas
    outliers: Mapping[str, IntArray] = field(default_factory=dict)

    def table(self) -> PoseTable:
        """Return one row for each reading of a point, pose by pose; without points, one for each visit and target."""
        read = self.errors.data.readings
        points = [
            (instrument, rows)
            for instrument, part, rows in self.errors.parts()
            if part.is_position and len(rows) == 3 and instrument.points(read[instrument.name].values) is not None
        ]
        parts = [self._rows_of(instrument, rows) for instrument, rows in points]
        if not any(len(table) for table, _ in parts):
            return self._predicted_points()
        order = np.argsort(
            self.errors.data.pose_numbers[np.concatenate([visits for _, visits in parts])], kind="stable"
        )
        first, *others = (table for table, _ in parts)
        return first.followed_by(others).subset(order)

    def _rows_of(self, instrument: Instrument, columns: IntArray) -> tuple[PoseTable, IntArray]:
        """One row for each reading of an instrument, and the visit of each."""
        data, name = self.errors.data, instrument.name
        points = instrument.points(data.readings[name].values)
        assert points is not None  # it has a position
        complete = np.flatnonzero(np.isfinite(points).all(axis=1))
        readings, measured = data.readings[name].subset(complete), points[complete]
        errors = {state: getattr(self.errors, state)[name][:, columns][complete] for state in STATES}
        names = [name] * len(complete)
        for number, setup in enumerate(self.placed.description.setups):
            rows = np.flatnonzero(readings.pairs == number)
            if number > 0 and len(rows):
                R, p = _transform_to_first_setup(self.placed, instrument, number)
                measured[rows] = measured[rows] @ R.T + p
                for off in errors.values():
                    off[rows] = off[rows] @ R.T
                for row in rows:
                    names[row] = f"{name}@{setup}"
        spread = np.full(measured.shape, np.nan)
        if self.predictions is not None and isinstance(instrument, FrameInstrument):
            spread = self.predictions.std[readings.visits, self.placed.target_names.index(instrument.target)]
        table = PoseTable(
            joints=data.joints[readings.visits],
            measured=measured,
            before=measured + errors["before"],
            after=measured + errors["after"],
            sigma=np.full(len(complete), self.sigmas.get(name, np.nan)),
            spread=spread,
            outlier=np.isin(complete, self.outliers.get(name, ())),
            targets=tuple(names),
            **self._origin_columns(readings.visits),
        )
        return table, readings.visits

    def _predicted_points(self) -> PoseTable:
        """One row for each visit and target, with predictions and nothing measured."""
        data, known = self.errors.data, self.predictions
        visits, columns = _without_readings(self.placed, data.joints)
        if known is not None:
            columns |= {"after": known.positions.reshape(-1, 3), "spread": known.std.reshape(-1, 3)}
        marked = [data.readings[name].visits[own] for name, own in self.outliers.items()]
        outlier = np.isin(visits, np.concatenate([np.zeros(0, dtype=np.intp), *marked]))
        return PoseTable(**columns, outlier=outlier, **self._origin_columns(visits))

    def _origin_columns(self, visits: IntArray) -> dict[str, Any]:
        """Columns on the origin of the rows of these visits (n,)."""
        n, data = len(visits), self.errors.data
        return {
            "group": (self.group,) * n,
            "labels": tuple(data.names[visit] for visit in visits),
            "readings": np.ones(n, dtype=np.intp),
            "series": (data.path,) * n,
            "place": data.places[visits],
        }


@memoize
def shown_sets(fit: Fit) -> list[ShownSet]:
    """Return the sets of a fit: identification, then validation and excluded outliers, if there are any."""
    sets = [fitted_set(fit, IDENTIFICATION, fit.identification, fit.identification_uncertainty)]
    if fit.validation is not None:
        sets.append(fitted_set(fit, VALIDATION, fit.validation, fit.validation_uncertainty))
    left_out = findings.excluded_errors(fit)
    if left_out is not None:
        data, every = left_out.data, {name: np.arange(len(own)) for name, own in left_out.data.readings.items()}
        predictions = fit.reported_uncertainty.predict(data.joints, data.conditions)
        sets.append(ShownSet(EXCLUDED, left_out, fit.placed, predictions, noise(fit), every))
    return sets


def fitted_set(fit: Fit, group: str, errors: ErrorSet, predictions: PositionUncertainty | None = None) -> ShownSet:
    """Return the used poses of a fit, or the validation poses, with the errors to show."""
    validates = group == VALIDATION
    outliers = findings.validation_outliers(fit) if validates else findings.outliers(fit)
    rows = fit.validation_rows if validates else fit.rows
    marked = {} if rows is None else numbers_by_instrument([outlier.reading for outlier in outliers], rows.layout)
    return ShownSet(group, errors, fit.placed, predictions, noise(fit), marked)


def measured_set(data: Measurements, nominal: Robot, calibrated: PredictingRobot | None, sigmas: Sigmas) -> ShownSet:
    """Return measurements that were in no fit, with errors of the robots before and, if any, after calibration.

    Raises:
        UnreachablePoseError: A pose cannot be assembled.
    """
    before = _errors_of(nominal, data)
    after, predictions = {name: np.full_like(errors, np.nan) for name, errors in before.items()}, None
    if calibrated is not None:
        after = _errors_of(calibrated.robot, data)
        predictions = calibrated.predict(data.joints, data.conditions)
    errors = ErrorSet(data, nominal.instruments, before, after, np.full(len(data), np.nan))
    return ShownSet(MEASURED, errors, nominal, predictions, sigmas)


def _errors_of(robot: Robot, data: Measurements) -> dict[str, FloatArray]:
    configurations = robot.assemble(data.joints, labels=data.labels, context=data.conditions)
    observed = observe(robot, configurations, data.readings, derivatives=False)
    return {name: block.residuals for name, block in observed.items()}


def from_fit(fit: Fit) -> PoseTable:
    """Return the poses of a fit, identification first, excluded outliers last."""
    used, *others = shown_sets(fit)
    tables = [used.table()]
    for shown in others:
        tables += _left_out_points(shown, used.errors.data) if shown.group == EXCLUDED else [shown.table()]
    if fit.validation is not None and not _are_of_one_file(fit.identification.data, fit.validation.data):
        names = (IDENTIFICATION, VALIDATION, IDENTIFICATION)  # excluded ones belong to identification
        tables = [
            replace(table, series=tuple(f"{path} ({name})" for path in table.series))
            for table, name in zip(tables, names, strict=False)
        ]
    return average_poses(tables[0].followed_by(tables[1:]))


def _left_out_points(shown: ShownSet, used: Measurements) -> list[PoseTable]:
    """The points that a fit excluded; if no instrument measures points, the excluded visits."""
    table = shown.table()
    if any(part.is_position for _, part, _ in shown.errors.parts()):
        return [table]
    if any(part.is_position for instrument in shown.errors.instruments for part in instrument.parts):
        return []
    stay = {(name, q.tobytes()) for name, q in zip(used.names, used.joints, strict=True)}
    whole = [(name, q.tobytes()) not in stay for name, q in zip(table.labels, table.joints, strict=True)]
    return [table.subset(np.array(whole, dtype=bool))] if any(whole) else []


def from_plan(robot: Robot, poses: Poses, hits: tuple[str, ...]) -> PoseTable:
    """Return poses without readings, at the positions that a robot predicts; `hits` (n,) are colliding pairs, or "".

    Raises:
        UnreachablePoseError: A pose cannot be assembled.
    """
    visits, columns = _without_readings(robot, poses.joints)
    return PoseTable(
        **columns,
        group=tuple(COLLIDES if hits[visit] else PLANNED for visit in visits),
        outlier=np.zeros(len(visits), dtype=bool),
        labels=tuple(f"{poses.names[k]}: {hits[k]}" if hits[k] else poses.names[k] for k in visits.tolist()),
        readings=np.ones(len(visits), dtype=np.intp),
        series=(poses.path,) * len(visits),
        place=visits,
    )


def _without_readings(robot: Robot, joints: FloatArray) -> tuple[IntArray, dict[str, Any]]:
    """The pose of each row, with a row for each pose and target; and columns of positions that nothing measured."""
    rows = np.repeat(np.arange(len(joints)), len(robot.target_names))
    unknown = np.full((len(rows), 3), np.nan)
    columns = dict.fromkeys(("measured", "after", "spread"), unknown) | {"sigma": unknown[:, 0], "joints": joints[rows]}
    places = {"before": robot.positions(joints).reshape(-1, 3), "targets": robot.target_names * len(joints)}
    return rows.astype(np.intp), columns | places


def noise(fit: Fit) -> Sigmas:
    """Return the estimated noise of point measurements, by instrument."""
    found = reversed([noise for noise in fit.noise if noise.group.part.is_position])
    by_group = {noise.group.name: noise.sigma for noise in found}
    instruments = [instrument for instrument in fit.robot.instruments if instrument.group in by_group]
    return {instrument.name: by_group[instrument.group] for instrument in instruments}


def _are_of_one_file(first: Measurements, second: Measurements) -> bool:
    """Whether two sets are parts of one file, so that their places have one order."""
    return first.path == second.path and not np.intersect1d(first.places, second.places).size


def _transform_to_first_setup(robot: Robot, instrument: Instrument, setup: int) -> tuple[FloatArray, FloatArray]:
    """Rotation (3, 3) and origin (3,) [m] of the measurement frame of a setup, in the frame of the first setup."""
    first, later = robot.pairs[instrument.name][0], robot.pairs[instrument.name][setup]
    names = robot.mechanism.origin_names
    T = robot.mechanism.placement(names[first.a - 1]).inverse() * robot.mechanism.placement(names[later.a - 1])
    return T.rotation.copy(), T.translation.copy()
