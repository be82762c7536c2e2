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
from calib.core.data.measurements import Poses
from calib.core.fitting.error_sets import ErrorSet
from calib.core.fitting.outliers import Outlier, numbers_by_instrument
from calib.core.instruments.kind import FrameInstrument, Instrument
from calib.core.judging import findings
from calib.core.rows.observed import predict_readings
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
class _Set:
    """Measurements of one group, and the errors of the predictions of robots.

    Attributes:
        group: Group of the pose table.
        data: The measurements.
        placed: The robot before calibration.
        before, after: Predicted minus measured points, by instrument, (n, 3) [m].
        predictions: Positions that the calibrated robot predicts at each visit; None if there is no such robot.
        sigmas: Noise.
        outliers: Indices of outlying readings, by instrument.
    """

    group: str
    data: Measurements
    placed: Robot
    before: Mapping[str, FloatArray]
    after: Mapping[str, FloatArray]
    predictions: PositionUncertainty | None
    sigmas: Sigmas
    outliers: Mapping[str, IntArray] = field(default_factory=dict)


def from_fit(fit: Fit) -> PoseTable:
    """Return the poses of a fit, identification first, excluded outliers last."""
    sets = [
        pose_table_of_errors(
            fit, IDENTIFICATION, fit.identification, fit.identification_uncertainty, findings.outliers(fit)
        )
    ]
    if fit.validation is not None:
        sets.append(
            pose_table_of_errors(
                fit, VALIDATION, fit.validation, fit.validation_uncertainty, findings.validation_outliers(fit)
            )
        )
    calibrated = PredictingRobot(fit.robot, fit.reported_uncertainty.predict)
    sets += _left_out_table(findings.excluded_errors(fit), fit.identification, fit.placed, calibrated, noise(fit))
    if fit.validation is not None and not _are_of_one_file(fit.identification.data, fit.validation.data):
        names = (IDENTIFICATION, VALIDATION, IDENTIFICATION)  # excluded ones belong to identification
        sets = [
            replace(table, series=tuple(f"{path} ({name})" for path in table.series))
            for table, name in zip(sets, names, strict=False)
        ]
    return average_poses(sets[0].followed_by(sets[1:]))


def _left_out_table(
    errors: ErrorSet | None, used: ErrorSet, placed: Robot, calibrated: PredictingRobot, sigmas: Sigmas
) -> list[PoseTable]:
    """The points that a fit excluded; if no instrument measures points, the excluded visits."""
    if errors is None:
        return []
    data = errors.data
    if any(_measures_points(instrument) for instrument in placed.instruments):
        data = data.with_readings(
            {
                name: np.arange(len(own))
                for name, own in data.readings.items()
                if _measures_points(placed.instrument(name))
            }
        )
    else:
        stay = {(name, q.tobytes()) for name, q in zip(used.data.names, used.data.joints, strict=True)}
        whole = [(name, q.tobytes()) not in stay for name, q in zip(data.names, data.joints, strict=True)]
        data = data.subset(np.flatnonzero(whole))
    if not len(data):
        return []
    table = _unjudged_table(EXCLUDED, data, placed, calibrated, sigmas)
    return [replace(table, outlier=np.ones(len(table), dtype=bool))]


def pose_table_of_errors(
    fit: Fit,
    group: str,
    errors: ErrorSet,
    predictions: PositionUncertainty | None = None,
    outliers: tuple[Outlier, ...] = (),
) -> PoseTable:
    """Return one row, with its errors, for each reading of a point in a set of a fit.

    `predictions` are positions that the calibrated robot predicts at each visit.
    """
    before, after = (_position_errors(errors, state) for state in ("before", "after"))
    rows = fit.validation_rows if group == VALIDATION else fit.rows
    marked = {} if rows is None else numbers_by_instrument([outlier.reading for outlier in outliers], rows.layout)
    return _rows(_Set(group, errors.data, fit.placed, before, after, predictions, noise(fit), marked))


def from_measurements(
    data: Measurements, nominal: Robot, calibrated: PredictingRobot | None, sigmas: Sigmas
) -> PoseTable:
    """Return measurements with the predictions for them of the robots before and, if any, after calibration.

    Raises:
        UnreachablePoseError: A pose cannot be assembled.
    """
    return average_poses(_unjudged_table(MEASURED, data, nominal, calibrated, sigmas))


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
    by_group = {
        group_noise.group.name: group_noise.sigma
        for group_noise in reversed(fit.noise)
        if group_noise.group.part.is_position
    }
    return {
        instrument.name: by_group[instrument.group]
        for instrument in fit.robot.instruments
        if instrument.group in by_group
    }


def _position_errors(errors: ErrorSet, state: str) -> dict[str, FloatArray]:
    return {
        instrument.name: getattr(errors, state)[instrument.name][:, rows]
        for instrument, part, rows in errors.parts()
        if part.is_position
    }


def _unjudged_table(
    group: str, data: Measurements, placed: Robot, calibrated: PredictingRobot | None, sigmas: Sigmas
) -> PoseTable:
    """Rows of measurements that were in no fit."""
    before = _point_errors(placed, data)
    if calibrated is None:
        unknown = {name: np.full_like(errors, np.nan) for name, errors in before.items()}
        return _rows(_Set(group, data, placed, before, unknown, None, sigmas))
    after, predictions = _point_errors(calibrated.robot, data), calibrated.predict(data.joints, data.conditions)
    return _rows(_Set(group, data, placed, before, after, predictions, sigmas))


def _point_errors(robot: Robot, data: Measurements) -> dict[str, FloatArray]:
    """Predicted minus measured points, (n, 3) [m], by instrument that measures points."""
    points_read = {
        name: readings for name, readings in data.readings.items() if _measures_points(robot.instrument(name))
    }
    if not points_read:
        return {}
    predicted = predict_readings(robot, robot.assemble(data.joints, labels=data.labels), points_read)
    off: dict[str, FloatArray] = {}
    for name, readings in points_read.items():
        instrument = robot.instrument(name)
        predicted_points, measured_points = (
            instrument.points(predicted[name].values),
            instrument.points(readings.values),
        )
        if predicted_points is not None and measured_points is not None:
            off[name] = predicted_points - measured_points
    return off


def _measures_points(instrument: Instrument) -> bool:
    return any(part.is_position for part in instrument.parts)


def _are_of_one_file(first: Measurements, second: Measurements) -> bool:
    """Whether two sets are parts of one file, so that their places have one order."""
    return first.path == second.path and not np.intersect1d(first.places, second.places).size


def _rows(source: _Set) -> PoseTable:
    """One row for each reading of a point, pose by pose; without points, one for each visit and target."""
    parts, visits = [], []
    for instrument in source.placed.instruments:
        if instrument.name in source.before:
            table, table_visits = _rows_of(source, instrument)
            parts.append(table)
            visits.append(table_visits)
    if not any(map(len, parts)):
        return _predictions(source)
    order = np.argsort(source.data.pose_numbers[np.concatenate(visits)], kind="stable")
    return parts[0].followed_by(parts[1:]).subset(order)


def _rows_of(source: _Set, instrument: Instrument) -> tuple[PoseTable, IntArray]:
    """One row for each reading of an instrument, and the visit of each."""
    readings = source.data.readings[instrument.name]
    points = instrument.points(readings.values)
    assert points is not None  # it has a position
    complete = np.flatnonzero(np.isfinite(points).all(axis=1))
    visits, pairs, measured = readings.visits[complete], readings.pairs[complete], points[complete]
    before, after = source.before[instrument.name][complete], source.after[instrument.name][complete]
    names = [instrument.name] * len(complete)
    for number, setup in enumerate(source.placed.description.setups):
        rows = np.flatnonzero(pairs == number)
        if number > 0 and len(rows):
            R, p = _transform_to_first_setup(source.placed, instrument, number)
            measured[rows] = measured[rows] @ R.T + p
            before[rows], after[rows] = before[rows] @ R.T, after[rows] @ R.T
            for row in rows:
                names[row] = f"{instrument.name}@{setup}"
    spread = np.full(measured.shape, np.nan)
    if source.predictions is not None and isinstance(instrument, FrameInstrument):
        spread = source.predictions.std[visits, source.placed.target_names.index(instrument.target)]
    table = PoseTable(
        joints=source.data.joints[visits],
        measured=measured,
        before=measured + before,
        after=measured + after,
        sigma=np.full(len(complete), source.sigmas.get(instrument.name, np.nan)),
        spread=spread,
        outlier=np.isin(complete, source.outliers.get(instrument.name, ())),
        targets=tuple(names),
        **_origin_columns(source, visits),
    )
    return table, visits


def _transform_to_first_setup(robot: Robot, instrument: Instrument, setup: int) -> tuple[FloatArray, FloatArray]:
    """Rotation (3, 3) and origin (3,) [m] of the measurement frame of a setup, in the frame of the first setup."""
    first, later = robot.pairs[instrument.name][0], robot.pairs[instrument.name][setup]
    names = robot.mechanism.origin_names
    T = robot.mechanism.placement(names[first.a - 1]).inverse() * robot.mechanism.placement(names[later.a - 1])
    return T.rotation.copy(), T.translation.copy()


def _predictions(source: _Set) -> PoseTable:
    """One row for each visit and target, with predictions and nothing measured."""
    visits, columns = _without_readings(source.placed, source.data.joints)
    if source.predictions is not None:
        known = source.predictions
        columns |= {"after": known.positions.reshape(-1, 3), "spread": known.std.reshape(-1, 3)}
    marked = {int(visit) for name, own in source.outliers.items() for visit in source.data.readings[name].visits[own]}
    return PoseTable(
        **columns,
        outlier=np.array([visit in marked for visit in map(int, visits)], dtype=bool),
        **_origin_columns(source, visits),
    )


def _origin_columns(source: _Set, visits: IntArray) -> dict[str, Any]:
    """Columns on the origin of the rows of these visits (n,)."""
    n = len(visits)
    return {
        "group": (source.group,) * n,
        "labels": tuple(source.data.names[visit] for visit in visits),
        "readings": np.ones(n, dtype=np.intp),
        "series": (source.data.path,) * n,
        "place": source.data.places[visits],
    }
