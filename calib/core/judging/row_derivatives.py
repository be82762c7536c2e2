"""Derivatives of the whitened rows of a fit, by errors that its model may leave out.

All are displacements of the targets through the robot, d(position)/d(joint) with loops closed, or motions of the
frames that positions are measured in, sizes of lengths, and constants and factors in the readings of instruments. Turns
and scales are taken about the middle of the points, so that they contain no shifts.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, IntArray
from calib.core.base.memoize import memoize
from calib.core.data.measurements import Measurements, Poses
from calib.core.fitting.fitted import Fit
from calib.core.instruments.kind import Comparison, FrameInstrument, Part, Readings, View
from calib.core.numerics.rigid import cross_matrices
from calib.core.robots.configurations import Configurations
from calib.core.robots.jacobian import relative_poses
from calib.core.robots.robot import Robot
from calib.core.rows.observed import observe, views_of_instruments

_ROUNDING = 1e-9  # part of its terms below which a sum is 0
_STEP = 1e-6  # relative change of angles, for a derivative


@dataclass(frozen=True, eq=False)
class EffectSetting:
    """The data of a fit from which effects are computed."""

    fit: Fit

    @property
    def data(self) -> Measurements:
        """Measurements that the fit has used."""
        return self.fit.identification.data

    def whiten(self, arrays: Mapping[str, FloatArray]) -> FloatArray:
        """Return effects on the rows of each instrument, (n, n_rows, k) [SI], as whitened rows, (n_all, k)."""
        rows = self.fit.whitening.whiten(arrays, self.fit.scales)
        return np.sqrt(self.fit.weights)[self.fit.whitening.layout.reading][:, None] * rows

    @cached_property
    def joint_columns(self) -> FloatArray:
        """Changes of the rows for an error of 1 of each joint, (n_rows, n_actuated)."""
        return self.whiten(self.fit.joint_derivative)

    @cached_property
    def frame_columns(self) -> FloatArray:
        """Changes of the rows for shifts and turns of the measurement frame, and for its lengths, (n_rows, 10)."""
        return self.whiten(_frame_derivative(self))

    def sizes(self, rows: FloatArray) -> FloatArray:
        """Return the root mean square of whitened rows (n_rows, k) over readings of each group, (n_groups, k) [SI]."""
        layout = self.fit.whitening.layout
        each = [layout.group == g for g in range(len(layout.groups))]
        counts = [np.count_nonzero(np.bincount(layout.reading[of])) for of in each]
        means = [np.sum(rows[of] ** 2, axis=0) / max(count, 1) for of, count in zip(each, counts, strict=True)]
        return np.stack([self.noise_of(g) * np.sqrt(mean) for g, mean in enumerate(means)])

    def noise_of(self, group: int) -> float:
        """Return the standard deviation of the noise of a row of a group [SI]."""
        return float(self.fit.scales[group] * self.fit.whitening.groups[group].typical)

    @cached_property
    def visit(self) -> IntArray:
        """Visit of each row, (n_rows,)."""
        layout = self.fit.whitening.layout
        return layout.visit[layout.reading]

    @cached_property
    def course(self) -> FloatArray:
        """Time of each visit, (n_visits,): its time [s], where all have it, else the order of the rows."""
        return np.asarray(self.data.context["time"] if has_time(self.data) else self.data.places, dtype=float)

    @cached_property
    def position_rows(self) -> dict[str, IntArray]:
        """Rows of the position, (3,), in a reading of each instrument that measures one in space."""
        rows: dict[str, list[int]] = {}
        for instrument, part, own in self.fit.identification.parts():
            if part.is_position:
                rows.setdefault(instrument.name, []).extend(own)
        return {name: np.array(own) for name, own in rows.items() if len(own) == 3}

    @cached_property
    def first(self) -> int:
        """Group of the positions; without positions, the first group."""
        return next((g for g, group in enumerate(self.fit.whitening.groups) if group.part.is_position), 0)


def has_time(data: Poses) -> bool:
    """Return whether the data say when each visit was made."""
    time = data.context.get("time")
    return time is not None and bool(np.all(np.isfinite(time))) and float(np.ptp(time)) > 0


def scales(setting: EffectSetting) -> FloatArray:
    """Return the change of the rows if all lengths are read too long, or those along x, y or z, (n_rows, 4)."""
    return -setting.frame_columns[:, 6:]


def constants(setting: EffectSetting) -> Iterator[tuple[str, int, FloatArray]]:
    """Yield instrument, group, and the changes of the rows if readings are too large by a constant, (n_rows, k).

    Positions that only one instrument reads are left out: that is a shift of the frame.
    """
    for name, part, group, rows in _parts(setting):
        if not part.is_position or len(setting.data.readings) > 1:
            yield name, group, _whitened_alone(setting, name, -np.eye(len(rows))[None, :, rows])


@memoize
def own_scales(setting: EffectSetting) -> dict[tuple[str, int], FloatArray]:
    """Return the change of the rows if one instrument reads a quantity too large, (n_rows, 1), by its name and group.

    Angles are too large as a file has them, in its form of rotations, unless they are too far off for a derivative. The
    others are those of several instruments: lengths, and what is too large from its middle, such as pixels of a lens
    with another focal length.
    """
    lengths, readings, result = _frame_derivative(setting), setting.data.readings, dict[tuple[str, int], FloatArray]()
    for name, part, group, rows in _parts(setting):
        values, change = readings[name].values, -lengths[name][:, :, 6]
        if part.dimension == "angle" and setting.noise_of(group) < part.largest:
            change = _change_by_angles(setting, name, rows)
        elif len(readings) == 1:
            continue
        elif (part.dimension != "length" or not np.any(change)) and values.shape == change.shape:
            change = np.nan_to_num(np.nanmean(values, axis=0) - values)
        if np.any(change[:, rows]):
            result[name, group] = _whitened_alone(setting, name, (change * rows)[:, :, None])
    return result


def _change_by_angles(setting: EffectSetting, name: str, rows: BoolArray) -> FloatArray:
    """Derivative of readings by the size of angles in their columns, else of the rotations, (n, n_rows)."""
    fit, readings = setting.fit, setting.data.readings[name]
    instrument, values = fit.robot.instrument(name), np.nan_to_num(readings.values)
    cells, angles = instrument.cells(values), [c.name for c in instrument.columns() if c.dimension == "angle"]
    larger = instrument.values(cells | {column: (1.0 + _STEP) * cells[column] for column in angles})
    if not angles and values.shape[1] == len(rows):
        larger = values * (1.0 + _STEP * rows)
    both = [
        observe(fit.robot, fit.configurations, {name: replace(readings, values=of)}, derivatives=False)[name].residuals
        for of in (values, larger)
    ]
    return np.where(np.all(np.isfinite(readings.values), axis=1, keepdims=True), (both[1] - both[0]) / _STEP, 0.0)


def _parts(setting: EffectSetting) -> Iterator[tuple[str, Part, int, BoolArray]]:
    """Yield instrument, part, its group, and which rows of a reading are its own, (n_rows,)."""
    groups = [(group.name, group.part) for group in setting.fit.whitening.groups]
    for instrument, part, rows in setting.fit.identification.parts():
        own = np.bincount(rows, minlength=instrument.n_rows) > 0
        yield instrument.name, part, groups.index((instrument.group, part)), own


def _whitened_alone(setting: EffectSetting, name: str, change: FloatArray) -> FloatArray:
    changes = _no_change(setting, change.shape[2])
    changes[name][:] = change
    return setting.whiten(changes)


def _no_change(setting: EffectSetting, count: int) -> dict[str, FloatArray]:
    read, robot = setting.data.readings, setting.fit.robot
    return {name: np.zeros((len(own), robot.instrument(name).n_rows, count)) for name, own in read.items()}


def errors_in_links(setting: EffectSetting, residuals: FloatArray) -> Iterator[tuple[IntArray, FloatArray, FloatArray]]:
    """Yield rows of the positions of each instrument, the axes of the target's link there, and errors along these.

    Rows are (n, 3), axes in the measurement frame (n, 3, 3), and errors (n, 3), by whitened residuals (n_rows,).
    """
    for name, target, of_position in seen_targets(setting):
        own = setting.fit.whitening.layout.rows_of(name)
        rows = np.arange(own.start, own.stop).reshape(-1, setting.fit.robot.instrument(name).n_rows)[:, of_position]
        moved = moved_targets(setting)[target][0]
        rows = rows[np.all(np.linalg.norm(moved[rows], axis=2) > 0, axis=1)]
        axes = -moved[rows] / np.linalg.norm(moved[rows], axis=2)[:, :, None]
        yield rows, axes, np.einsum("nij,ni->nj", axes, residuals[rows])


def gains(setting: EffectSetting) -> FloatArray:
    """Return the change of the rows if a joint turns too far by a relative error of 1, (n_rows, n_actuated)."""
    return setting.joint_columns * (setting.data.joints - np.mean(setting.data.joints, axis=0))[setting.visit]


@memoize
def _frame_derivative(setting: EffectSetting) -> dict[str, FloatArray]:
    """Derivative of readings by shifts along x, y, z, turns about them, and sizes of lengths, (n, n_rows, 10) each.

    The sizes are those of all lengths (`length_derivative`), positions from the middle of the points, and of positions
    along x, y and z. Along one axis they are as predicted: those of a planar robot would be noise alone.
    """
    result, points, fit, robot = _no_change(setting, 10), _points(setting), setting.fit, setting.fit.robot
    others = {k: own for k, own in setting.data.readings.items() if k not in points or robot.instrument(k).n_rows > 3}
    lengths = length_derivative(robot, fit.configurations, others) if others else {}  # those of points are replaced
    for name, columns in result.items():
        columns[:, :, 6] = lengths.get(name, 0.0)
    for name, rows in setting.position_rows.items():
        columns = result[name]
        columns[:, rows, :3] = np.eye(3)
        if name in points:
            columns[:, rows, 3:6] = cross_matrices(points[name])
            columns[:, rows, 6] = points[name]
            predicted = points[name] + np.nan_to_num(fit.identification.after[name][:, rows])
            columns[:, rows, 7:] = predicted[:, :, None] * np.eye(3)
    return result


def length_derivative(
    robot: Robot, configurations: Configurations, readings: Mapping[str, Readings]
) -> dict[str, FloatArray]:
    """Return the derivative of readings by the size of all lengths of the robot, (n, n_rows) of each instrument.

    Every translation p_ab grows in proportion. A board, or an artefact that is touched, keeps its size: one that is
    described too small looks like a robot that is too large. With the derivative J of a reading by p_ab, it is J p_ab;
    of readings that are lengths it is as read: a distance itself, the touched point of an artefact.
    """
    result = dict[str, FloatArray]()
    for name, seen in views_of_instruments(robot, configurations, readings).items():
        instrument = robot.instrument(name)
        result[name] = np.zeros((len(readings[name]), instrument.n_rows))
        if not isinstance(seen, View):
            continue
        compared = instrument.compare(seen, robot.values[robot.unknowns[name]], readings[name])
        assert isinstance(compared, Comparison)  # the kind looks at frames
        terms = np.nan_to_num(compared.by_twist[:, :, :3] * seen.translation[:, None])
        is_length = np.array([instrument.parts[part].dimension == "length" for part in instrument.part_of_row])
        errors = np.where(is_length & np.any(terms, axis=(0, 2)), np.nan_to_num(compared.residuals), 0.0)
        lengths = np.sum(terms, axis=2) - errors
        within = _ROUNDING * (np.sum(np.abs(terms), axis=2) + np.abs(errors))
        result[name] = np.where(np.abs(lengths) > within, lengths, 0.0)
    return result


def _points(setting: EffectSetting) -> dict[str, FloatArray]:
    """Points that were read, from the middle of all, (n, 3) [m] of each instrument that measures positions."""
    result = {}
    for name in setting.position_rows:
        points = setting.fit.robot.instrument(name).points(setting.data.readings[name].values)
        if points is not None and len(points):
            result[name] = points
    if not result:
        return {}
    middle = np.nanmean(np.concatenate(list(result.values())), axis=0)
    return {name: np.nan_to_num(points - middle) for name, points in result.items()}


def seen_targets(setting: EffectSetting) -> Iterator[tuple[str, str, IntArray]]:
    """Yield each instrument that measures the position of a target, its target and the rows of the position, (3,)."""
    for name, rows in setting.position_rows.items():
        instrument = setting.fit.robot.instrument(name)
        if isinstance(instrument, FrameInstrument):
            yield name, instrument.target, rows


def other_joints(robot: Robot, target: str) -> list[int]:
    """Return the joints that move, but do not move this target, as indices of their frames."""
    mechanism = robot.mechanism
    frame = mechanism.targets[robot.target_names.index(target)].b
    moving = np.any(mechanism.select_moving, axis=1)
    return [int(k) + 1 for k in np.flatnonzero(moving & (mechanism.support[frame] == 0))]


@memoize
def moved_targets(setting: EffectSetting) -> dict[str, list[FloatArray]]:
    """Return the changes of the rows if a target moves along the axes of a link, (n_rows, 3), by target.

    The first link is the target's own; the others are those behind each joint that does not move the target.
    """
    return {target: _moved_target(setting, target) for target in dict.fromkeys(t for _, t, _ in seen_targets(setting))}


def _moved_target(setting: EffectSetting, target: str) -> list[FloatArray]:
    robot, links = setting.fit.robot, [None, *other_joints(setting.fit.robot, target)]
    result = _no_change(setting, 3 * len(links))
    for name, own, rows in seen_targets(setting):
        if own == target:
            readings, pairs = setting.data.readings[name], robot.pairs[name]
            behind = tuple(pair if link is None else replace(pair, b=link) for link in links for pair in pairs)
            poses = relative_poses(robot.mechanism, setting.fit.configurations, behind)
            turned = poses.reshape(len(links), len(pairs), -1, 4, 4)[:, readings.pairs, readings.visits, :3, :3]
            result[name][:, rows] = -turned.transpose(1, 2, 0, 3).reshape(len(readings), 3, -1)
    return np.split(setting.whiten(result), len(links), axis=1)
