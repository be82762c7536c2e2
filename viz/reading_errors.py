"""Errors of readings other than positions, as arrows: their places, directions and sizes.

A reading constrains the observed point along some directions only. Its error is drawn as the smallest motion of that
point that explains it. With the residual r (predicted minus read) and its derivative J by the point's motion
(`calib.core.instruments.kind`),

    dp = J^+ r        from the point as read to the point as predicted

It is along the wire of a distance, along the normal of a plane, from the middle of a socket to the ball, and for a
pixel at the depth of the point, square to the line of sight. Readings that only rotations change (orientations,
inclinometers) have the smallest rotation that explains them, an arrow along its axis; readings of a joint have the
joint's axis. Colours show the residual itself, in its own unit.

When it fails. Beyond first order: a pixel far off in the image, or a rotation of much more than a tenth of a radian.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib import Fit, Measurements, Robot
from calib.core.base.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays
from calib.core.base.units import ERROR_UNIT
from calib.core.fitting.error_sets import STATES
from calib.core.instruments.kind import Comparison, FrameInstrument, JointInstrument, Part, View
from calib.core.numerics import linalg
from calib.core.results.sections.accuracy import before_in_use
from calib.core.robots import kinematics
from calib.core.robots.mechanism import RelativeFrame
from calib.core.robots.parametrisation import robot_in_use
from calib.core.rows.observed import views_of_instruments
from viz.pose_sources import ShownSet, shown_sets
from viz.poses import RowTable, spread_rows


@dataclass(frozen=True, eq=False)
class ReadingErrors(RowTable):
    """Errors of one part of readings, a row for each reading. Points and arrows are in the measurement frame.

    Attributes:
        part: The part.
        turns: Whether arrows are rotation vectors [rad] rather than motions [m].
        joints: Actuated joints, (n, n_actuated) [m or rad].
        anchors: Beginnings of the arrows, (n, 3) [m].
        before, after: Arrows, (n, 3) [m or rad]; NaN where unknown.
        residuals_before, residuals_after: Predicted minus read, (n, n_axes) [SI]; NaN where unknown.
        pixels: Places in images as read, (n, 2) [px]; (n, 0) for other readings.
        group: Group of each row, as in `PoseTable`.
        outlier: Mask of outliers, (n,).
        labels: Name of each pose.
        targets: Instrument of each row, with its target.
        instruments: Instrument of each row.
    """

    part: Part
    turns: bool
    joints: FloatArray
    anchors: FloatArray
    before: FloatArray
    after: FloatArray
    residuals_before: FloatArray
    residuals_after: FloatArray
    pixels: FloatArray
    group: tuple[str, ...]
    outlier: BoolArray
    labels: tuple[str, ...]
    targets: tuple[str, ...]
    instruments: tuple[str, ...]

    @property
    def unit(self) -> str:
        """Unit in which pages show these errors."""
        return ERROR_UNIT[self.part.dimension]

    def arrows(self, state: str) -> FloatArray:
        """Return the arrows `before` or `after` calibration, (n, 3) [m or rad]."""
        return np.asarray(getattr(self, state))

    def residuals(self, state: str) -> FloatArray:
        """Return predicted minus read `before` or `after`, (n, n_axes) [SI]."""
        return np.asarray(getattr(self, f"residuals_{state}"))

    def sizes(self, state: str) -> FloatArray:
        """Return the sizes of the errors, (n,) [SI]; NaN where no component is known."""
        residuals = self.residuals(state)
        known = np.isfinite(residuals).any(axis=1)
        return np.where(known, np.sqrt(np.nansum(residuals**2, axis=1)), np.nan)

    def rows_shown(self) -> IntArray:
        """Return the rows of a page, (n_shown,): all, or outliers, the largest errors and others evenly spread."""
        return spread_rows(self.outlier, [self.sizes(state) for state in STATES])


@dataclass(frozen=True, eq=False)
class _SeenReadings(ReadOnlyArrays):
    """Frames and joints that the readings of an instrument depend on, for one robot.

    Attributes:
        points: The observed point of each reading, (n, 3) [m].
        axes: Axes of the observing frame, (n, 3, 3).
        by_motion: Derivative of the residuals by the point's motion [dp; dw] in these axes, (n, n_rows, 6).
    """

    points: FloatArray
    axes: FloatArray
    by_motion: FloatArray


def reading_errors_of_fit(fit: Fit) -> tuple[ReadingErrors, ...]:
    """Return the errors of all readings of a fit other than positions, part by part."""
    placed = robot_in_use(fit.placed)
    sets = [replace(shown, errors=before_in_use(fit, shown.errors)) for shown in shown_sets(fit)]
    return _join_tables([table for shown in sets for table in _tables_of_set(shown, placed, fit.robot)])


def reading_errors_of_set(shown: ShownSet, calibrated: Robot | None) -> tuple[ReadingErrors, ...]:
    """Return the errors of readings other than positions, part by part, of measurements that were in no fit."""
    return _join_tables(_tables_of_set(shown, shown.placed, calibrated))


def _join_tables(tables: list[ReadingErrors]) -> tuple[ReadingErrors, ...]:
    """One table for each part; rows in the order of the sets."""
    by_part: dict[object, list[ReadingErrors]] = {}
    for table in tables:
        by_part.setdefault((table.part, table.turns), []).append(table)
    return tuple(first.followed_by(others) for first, *others in by_part.values())


def _tables_of_set(shown: ShownSet, placed: Robot, calibrated: Robot | None) -> list[ReadingErrors]:
    """The errors of a set of readings, by instrument and part, pose by pose."""
    data = shown.errors.data
    others = [part for part in shown.errors.parts() if not part[1].is_position]
    if not others:
        return []
    names = {instrument.name for instrument, _, _ in others}
    data = replace(data, readings={name: own for name, own in data.readings.items() if name in names})
    before = _seen_readings(placed, data)
    after = before if calibrated is None else _seen_readings(calibrated, data)
    tables = []
    for instrument, part, rows in others:
        readings, n = data.readings[instrument.name], len(data.readings[instrument.name])
        residuals = {state: getattr(shown.errors, state)[instrument.name][:, rows] for state in STATES}
        arrows, turns = {}, False
        for state, seen in (("before", before), ("after", after)):
            about = seen[instrument.name]
            motion, turns = smallest_motion(about.by_motion[:, rows], residuals[state])
            arrows[state] = np.einsum("nij,nj->ni", about.axes, motion)
        last = arrows["before" if calibrated is None else "after"]
        texts = instrument.texts(readings.pairs, readings.details)
        words = zip(*texts.values(), strict=True) if texts else [()] * n
        outlier = np.zeros(n, dtype=bool)
        outlier[shown.outliers.get(instrument.name, [])] = True
        table = ReadingErrors(
            part=part,
            turns=turns,
            joints=data.joints[readings.visits],
            anchors=after[instrument.name].points - (0.0 if turns else np.nan_to_num(last)),
            before=arrows["before"],
            after=arrows["after"],
            residuals_before=residuals["before"],
            residuals_after=residuals["after"],
            pixels=readings.values[:, rows] if part.dimension == "pixel" else np.zeros((n, 0)),
            group=(shown.group,) * n,
            outlier=outlier,
            labels=tuple(data.names[visit] for visit in readings.visits),
            targets=tuple(" ".join((instrument.name, *own)) for own in words),
            instruments=(instrument.name,) * n,
        )
        tables.append(table.subset(np.argsort(data.pose_numbers[readings.visits], kind="stable")))
    return tables


def smallest_motion(by_motion: FloatArray, residuals: FloatArray) -> tuple[FloatArray, bool]:
    """Return the smallest motions, or rotations, that explain residuals, and whether they are rotations.

    Args:
        by_motion: Derivative of the residuals by the motion [dp; dw], (n, n_axes, 6).
        residuals: Predicted minus read, (n, n_axes) [SI]; NaN for unread components.

    Returns:
        (n, 3) [m or rad]; NaN without a known component. And the flag.
    """
    turns = not by_motion[:, :, :3].any()
    slopes = by_motion[:, :, 3:] if turns else by_motion[:, :, :3]
    read: BoolArray = np.isfinite(residuals) & np.isfinite(slopes).all(axis=2)  # not finite behind a camera
    by = np.where(read[:, :, None], slopes, 0.0)
    residuals = np.where(read, residuals, 0.0)
    motion = np.einsum("nij,nj->ni", linalg.pinv(by, rcond=1e-9), residuals)
    return np.where(np.any(read, axis=1)[:, None], motion, np.nan), bool(turns)


def _seen_readings(robot: Robot, data: Measurements) -> dict[str, _SeenReadings]:
    """The observed points and frames of readings, by instrument."""
    configurations = robot.assemble(data.joints, labels=data.labels, context=data.conditions)
    mechanism, base = robot.mechanism, robot.mechanism.targets[0].a
    views, result = views_of_instruments(robot, configurations, data.readings), {}
    joints = mechanism.all_joints(configurations.actuated, configurations.passive)
    for name, readings in data.readings.items():
        instrument, seen = robot.instrument(name), views[name]
        poses: FloatArray = np.tile(np.eye(4), (len(readings), 1, 1))  # of the observing frame, or of the joint
        points: FloatArray = np.zeros((len(readings), 3))
        compared = instrument.compare(seen, robot.values[robot.unknowns[name]], readings)
        if isinstance(compared, Comparison):
            assert isinstance(instrument, FrameInstrument)
            assert isinstance(seen, View)
            for number, pair in enumerate(robot.pairs[instrument.name]):
                chosen = np.flatnonzero(readings.pairs == number)
                if pair.a != base and len(chosen):
                    poses[chosen] = _poses(robot, joints, base, pair.a)[readings.visits[chosen]]
            by_motion, points = compared.by_twist, instrument.point_seen(seen, readings.details)
        else:
            assert isinstance(instrument, JointInstrument)
            index = mechanism.origin_names.index(instrument.joint)
            poses = _poses(robot, joints, base, index + 1)[readings.visits]
            by_motion = compared.by_joint[:, :, None] * mechanism.axes[index]
        points = np.einsum("nij,nj->ni", poses[:, :3, :3], points) + poses[:, :3, 3]
        result[name] = _SeenReadings(points, poses[:, :3, :3], by_motion)
    return result


def _poses(robot: Robot, joints: FloatArray, base: int, frame: int) -> FloatArray:
    """Pose of a frame of the mechanism in the measurement frame at joint values (n, n_joints), (n, 4, 4) [m]."""
    pair = RelativeFrame("frame", base, frame, False, (0, 1, 2))
    return kinematics.relative_pose(kinematics.sweep(robot.mechanism, joints, (pair,)), base, frame)
