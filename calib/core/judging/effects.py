"""Effects that a model may leave out, as columns: their parts of the whitened rows of a fit.

All are displacements of the targets through the robot, d(position)/d(joint) with loops closed, or motions of the
frames that positions are measured in:

    axis, turn, scale      a constant shift, a constant turn of the measurement frame, lengths that are all too long
    offset, factor         a constant in the readings of one instrument, readings that are too large by a factor
    drift, turning, growth the same, changing smoothly in the course of the measurement: a tracker or a base that moved,
                           a robot or an instrument that warms up
    slip                   a target that sits elsewhere on its link from one visit on
    link                   a target that moves with a joint that should not move it: one described on another link
    joint                  each joint off by a smooth curve of its own value (Legendre polynomials of degree 1 to 3 over
                           the range measured): gear error, lead error, gravity sag
    wave                   each joint off by a sine of 1 to 120 cycles a turn: the teeth of a gear, an encoder's lines
    coupling               each joint off in proportion to the value of a neighbour: gears or belts on one shaft
    approach               each joint off by +-b, by the direction in which it moved last: backlash 2b
    zero                   each joint off by an error that changes in the course of the measurement: an encoder or a
                           belt that slipped, warming up

Turns and scales are taken about the middle of the points, so that they contain no shifts. The course of the measurement
is the time, where the data have it, and else the order of the rows. A sudden change shows too: a polynomial of degree 3
explains 86 % of a step. Joints that never moved get no effects.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.data.measurements import Measurements, Poses
from calib.core.fitting.fitted import Fit
from calib.core.fitting.pose_checks import unmoved_joints
from calib.core.instruments.kind import Comparison, FrameInstrument, Instrument, Readings, View
from calib.core.judging.effect_kinds import Kind
from calib.core.numerics.variance_components import SharedError
from calib.core.robots.configurations import Configurations
from calib.core.robots.jacobian import relative_poses
from calib.core.robots.robot import Robot
from calib.core.robots.terms.periodic import TURN
from calib.core.rows.observed import views_of_instruments

ORDERS = range(1, 121)
"""Cycles of a wave in a turn of the joint, or over the range that a joint slides."""
SLIPS = 15
"""Number of places in the course of the measurement at which a slip of a target is tested."""
_ROUNDING = 1e-9  # part of its terms below which a sum is 0
_SAME = 1e-6  # cycles that rounding may add
_ON_GRID = 0.99  # a wave of length 1 is the same at all visits if its mean is longer than this
_LIKELY, _VISITS_LOOKED_AT = 0.9, 32  # it may be if its mean over so many visits is longer than this


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
        rows = self.fit.whitening.whiten(arrays, self.fit.scales.groups)
        if self._weighing is not None:
            rows = self._weighing.whiten(rows)
        return np.sqrt(self.fit.weights)[self.fit.whitening.layout.reading][:, None] * rows

    @cached_property
    def _weighing(self) -> SharedError | None:
        return self.fit.whitening.weighing(self.fit.scales.ratios)

    @cached_property
    def joint_columns(self) -> FloatArray:
        """Changes of the rows for an error of 1 of each joint, (n_rows, n_actuated)."""
        return self.whiten(self.fit.joint_derivative)

    @cached_property
    def frame_derivative(self) -> dict[str, FloatArray]:
        """Changes of the readings of each instrument as in `frame_columns`, (n, n_rows, 10) [SI]."""
        return _frame_derivative(self)

    @cached_property
    def frame_columns(self) -> FloatArray:
        """Changes of the rows for shifts and turns of the measurement frame, and for its lengths, (n_rows, 10)."""
        return self.whiten(self.frame_derivative)

    @cached_property
    def own_scales(self) -> dict[str, FloatArray]:
        """Change of the rows if one of several instruments reads lengths too long, (n_rows, 1), by its name.

        Other readings than lengths are too large from their middle: pixels of a lens with another focal length.
        """
        if len(self.data.readings) == 1:  # that is a scale of all lengths
            return {}
        changes = {name: -columns[:, :, 6:7] for name, columns in self.frame_derivative.items()}
        for name, readings in self.data.readings.items():
            lengths = self.fit.robot.instrument(name).parts[0].dimension == "length" and np.any(changes[name])
            if not lengths and readings.values.shape == changes[name].shape[:2]:
                changes[name] = np.nan_to_num(np.nanmean(readings.values, axis=0) - readings.values)[:, :, None]
        shown = [name for name, columns in changes.items() if np.any(columns)]
        return {name: self.whiten({other: (other == name) * changes[other] for other in changes}) for name in shown}

    @cached_property
    def moved_targets(self) -> dict[str, list[FloatArray]]:
        """Changes of the rows if a target moves along the axes of a link, (n_rows, 3), by target.

        The first link is the target's own; the others are those behind each joint that does not move the target.
        """
        return {target: _moved_target(self, target) for target in dict.fromkeys(t for _, t, _ in _seen_targets(self))}

    @cached_property
    def effects(self) -> tuple[Effects, ...]:
        """Every effect."""
        return tuple(
            effect
            for some in (_frame_effects, _instrument_effects, _target_effects, _joint_effects)
            for effect in some(self)
        )

    def sizes(self, rows: FloatArray) -> FloatArray:
        """Return the root mean square of whitened rows (n_rows, k) over readings of each group, (n_groups, k) [SI]."""
        layout, whole = self.fit.whitening.layout, rows if self._weighing is None else self._weighing.unwhiten(rows)
        each = [layout.group == g for g in range(len(layout.groups))]
        means = [np.sum(whole[of] ** 2, axis=0) / max(len(np.unique(layout.reading[of])), 1) for of in each]
        return np.stack([self.noise_of(g) * np.sqrt(mean) for g, mean in enumerate(means)])

    def noise_of(self, group: int) -> float:
        """Return the standard deviation of the noise of a row of a group [SI]."""
        return float(self.fit.scales.groups[group] * self.fit.whitening.groups[group].typical)

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
    def first(self) -> int:
        """Group of the positions; without positions, the first group."""
        return next((g for g, group in enumerate(self.fit.whitening.groups) if group.part.is_position), 0)


def has_time(data: Poses) -> bool:
    """Return whether the data say when each visit was made."""
    time = data.context.get("time")
    return time is not None and bool(np.all(np.isfinite(time))) and float(np.ptp(time)) > 0


@dataclass(frozen=True, eq=False)
class Effects:
    """Effects of one kind on one thing; each adds B (x) F: every column of B times every factor of F.

    Attributes:
        kind: The kind of effect.
        name: Its axis, joint, target or instrument; `xyz` for all axes.
        base: B, change of the whitened rows, (n_rows, b).
        visit: Visit of each row, (n_rows,).
        details: Detail of each effect, as in `Pattern`.
        by_visit: F of each effect at each visit, (n_visits, n_effects, f); None: one effect, and F is 1.
        group: The group whose readings it changes; None: that of the positions.
    """

    kind: Kind
    name: str
    base: FloatArray
    visit: IntArray
    details: Sequence[str] = ("",)
    by_visit: FloatArray | None = None
    group: int | None = None

    def factors(self, visits: IntArray) -> FloatArray:
        """Return F of every effect at visits (n,), (n, n_effects, f)."""
        return np.ones((len(visits), 1, 1)) if self.by_visit is None else self.by_visit[visits]

    def factors_of(self, number: int) -> FloatArray:
        """Return F of one effect at all visits, (n_visits, f)."""
        return np.ones((int(np.max(self.visit)) + 1, 1)) if self.by_visit is None else self.by_visit[:, number]

    def columns(self, number: int) -> FloatArray:
        """Return all columns of one effect, (n_rows, b f)."""
        factors = self.factors_of(number)[self.visit]
        return (self.base[:, :, None] * factors[:, None, :]).reshape(len(self.base), -1)

    def times(self, number: int, coefficients: FloatArray) -> FloatArray:
        """Return the columns of one effect times coefficients (b f,), (n_rows,)."""
        weights = self.factors_of(number) @ coefficients.reshape(self.base.shape[1], -1).T
        return np.asarray(np.einsum("ij,ij->i", self.base, weights[self.visit]))


@dataclass(frozen=True, eq=False, kw_only=True)
class Waves(Effects):
    """The waves of one joint: cosine and sine of each of `orders` times a phase.

    Attributes:
        phase: Phase of the first order at each visit, (n_visits,) [rad].
        orders: Cycles of each effect.
    """

    phase: FloatArray
    orders: range

    def factors(self, visits: IntArray) -> FloatArray:
        """Return cosine and sine of every order at visits (n,), (n, n_orders, 2)."""
        waves = powers(np.exp(1j * self.phase[visits]), self.orders.stop - 1)
        return waves.view(float).reshape(len(visits), -1, 2)[:, self.orders.start - 1 :]

    def factors_of(self, number: int) -> FloatArray:
        """Return cosine and sine of one order at all visits, (n_visits, 2)."""
        angle = self.orders[number] * self.phase
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def powers(turned: NDArray[np.complex128], count: int) -> NDArray[np.complex128]:
    """Return z, z^2, ... of complex numbers z (n,), (n, count)."""
    result = np.empty((len(turned), count), dtype=complex)
    result[:, 0], known = turned, 1
    while known < count:
        more = min(known, count - known)
        np.multiply(result[:, :more], result[:, known - 1 : known], out=result[:, known : known + more])
        known += more
    return result


def wave_orders(phase: FloatArray) -> range:
    """Return the numbers of cycles to test for a joint with these phases of one cycle, (n_visits,) [rad].

    An order counts only if the joint went through half a cycle of it: otherwise its height is not known. If joint
    values lie on a grid (every 5 degrees), an order above half the grid's cycles in a turn (36) equals a lower one at
    all poses: only the lower one counts.
    """
    reach = float(np.ptp(phase))
    if reach == 0:
        return range(0)
    few = phase[:: len(phase) // _VISITS_LOOKED_AT + 1]
    same = np.abs(np.mean(powers(np.exp(1j * few), 2 * ORDERS.stop - 1), axis=0)) > _LIKELY
    same[: int(np.ceil(TURN / reach - _SAME)) - 1] = False  # less than one cycle
    likely = (np.flatnonzero(same) + 1).tolist()
    grid = next((order for order in likely if abs(np.mean(np.exp(1j * order * phase))) > _ON_GRID), 2 * ORDERS.stop)
    stop = min(grid // 2 + 1, ORDERS.stop)
    return range(min(int(np.ceil(TURN / 2 / reach - _SAME)), stop), stop)


def scales(setting: EffectSetting) -> FloatArray:
    """Return the change of the rows if all lengths are read too long, or those along x, y or z, (n_rows, 4)."""
    return -setting.frame_columns[:, 6:]


def constants(setting: EffectSetting) -> Iterator[tuple[str, int, FloatArray]]:
    """Yield instrument, group, and the changes of the rows if readings are too large by a constant, (n_rows, k).

    Positions that only one instrument reads are left out: that is a shift of the frame.
    """
    robot, groups, readings = setting.fit.robot, setting.fit.whitening.groups, setting.data.readings
    for name in readings:
        instrument = robot.instrument(name)
        for number, part in enumerate(instrument.parts):
            if part.is_position and len(readings) == 1:
                continue
            rows = [k for k, of in enumerate(instrument.part_of_row) if of == number]
            group = next(g for g, known in enumerate(groups) if (known.name, known.part) == (instrument.group, part))
            own = -np.eye(instrument.n_rows)[:, rows]
            arrays = {
                other: np.tile(own, (len(read), 1, 1))
                if other == name
                else np.zeros((len(read), robot.instrument(other).n_rows, len(rows)))
                for other, read in readings.items()
            }
            yield name, group, setting.whiten(arrays)


def errors_in_links(setting: EffectSetting, residuals: FloatArray) -> Iterator[tuple[IntArray, FloatArray, FloatArray]]:
    """Yield rows of the positions of each instrument, the axes of the target's link there, and errors along these.

    Args:
        residuals: Whitened residuals, (n_rows,).

    Returns:
        Rows, (n, 3); axes in the measurement frame, (n, 3, 3); errors over the standard deviation of a row, (n, 3).
    """
    for name, target, of_position in _seen_targets(setting):
        own = setting.fit.whitening.layout.rows_of(name)
        rows = np.arange(own.start, own.stop).reshape(-1, setting.fit.robot.instrument(name).n_rows)[:, of_position]
        moved = setting.moved_targets[target][0]
        rows = rows[np.all(np.linalg.norm(moved[rows], axis=2) > 0, axis=1)]
        axes = -moved[rows] / np.linalg.norm(moved[rows], axis=2)[:, :, None]
        yield rows, axes, np.einsum("nij,ni->nj", axes, residuals[rows])


def gains(setting: EffectSetting) -> FloatArray:
    """Return the change of the rows if a joint turns too far by a relative error of 1, (n_rows, n_actuated)."""
    return setting.joint_columns * (setting.data.joints - np.mean(setting.data.joints, axis=0))[setting.visit]


def _frame_effects(setting: EffectSetting) -> Iterator[Effects]:
    shifts, turns = setting.frame_columns[:, :3], setting.frame_columns[:, 3:6]
    groups, visit = setting.fit.whitening.groups, setting.visit
    read = np.array([group.part.is_position or group.part.is_distance for group in groups])  # lengths themselves
    lengths = scales(setting)[:, :1] * read[setting.fit.whitening.layout.group][:, None]
    for axis, name in enumerate("xyz"):
        yield Effects(Kind.AXIS, name, shifts[:, axis : axis + 1], visit)
    in_course = _curves(setting.course)
    yield Effects(Kind.DRIFT, "xyz", shifts, visit, by_visit=in_course)
    yield Effects(Kind.TURN, "xyz", turns, visit)
    yield Effects(Kind.TURNING, "xyz", turns, visit, by_visit=in_course)
    yield Effects(Kind.SCALE, "xyz", lengths, visit)
    yield Effects(Kind.GROWTH, "xyz", lengths, visit, by_visit=in_course)


def _instrument_effects(setting: EffectSetting) -> Iterator[Effects]:
    """Constants in the readings of each instrument, and what one of several reads too large by a factor."""
    scaled = setting.own_scales
    for name, group, columns in constants(setting):
        yield Effects(Kind.OFFSET, name, columns, setting.visit, group=group)
        if name in scaled and np.any(scaled[name][setting.fit.whitening.layout.group == group]):
            yield Effects(Kind.FACTOR, name, scaled[name], setting.visit, group=group)


def _target_effects(setting: EffectSetting) -> Iterator[Effects]:
    """Targets that slip, at evenly spread visits, and targets that move with other links."""
    order = np.argsort(setting.course, kind="stable")
    rank = np.empty(len(order), dtype=np.intp)
    rank[order] = np.arange(len(order))
    firsts = np.unique(np.linspace(0, len(order), SLIPS + 2)[1:-1].astype(np.intp))
    late = (rank[:, None] >= firsts).astype(float)[:, :, None]
    slips = [f"from {setting.data.labels[order[first]]} on" for first in firsts]
    for target, (own, *others) in setting.moved_targets.items():
        for joint, moved in zip(_other_joints(setting.fit.robot, target), others, strict=True):
            before = setting.fit.robot.mechanism.origin_names[joint - 1]
            yield Effects(Kind.LINK, target, moved, setting.visit, (before,))
        yield Effects(Kind.SLIP, target, own, setting.visit, slips, late)


def _joint_effects(setting: EffectSetting) -> Iterator[Effects]:
    robot, data, visit = setting.fit.robot, setting.data, setting.visit
    names, in_course, directions = robot.joint_names, _curves(setting.course), data.approach_directions
    still = unmoved_joints(robot, data.joints)
    for j, name in enumerate(names):
        if name in still:
            continue
        column, q = setting.joint_columns[:, j : j + 1], data.joints[:, j]
        yield Effects(Kind.JOINT, name, column, visit, by_visit=_curves(q))
        yield Effects(Kind.APPROACH, name, column, visit, by_visit=directions[:, j, None, None])
        yield Effects(Kind.ZERO, name, column, visit, by_visit=in_course)
        drivers = [k for k in (j - 1, j + 1) if 0 <= k < len(names) and names[k] not in still]
        if drivers:
            driving = (np.mean(data.joints, axis=0) - data.joints)[:, drivers, None]
            yield Effects(Kind.COUPLING, name, column, visit, [names[k] for k in drivers], driving)
        turns = robot.mechanism.dimensions[name] == "angle"
        unit = "cycles a turn" if turns else "cycles over the range measured"
        phase = q if turns else q * (TURN / float(np.ptp(q)))
        orders = wave_orders(phase)
        if orders:
            details = [f"{order} {unit}" for order in orders]
            yield Waves(Kind.WAVE, name, column, visit, details, phase=phase, orders=orders)


def _position_rows(instrument: Instrument) -> list[int]:
    """Rows of an instrument that are the position of its target; none for kinds that measure none."""
    return [k for k, part in enumerate(instrument.part_of_row) if instrument.parts[part].is_position]


def _frame_derivative(setting: EffectSetting) -> dict[str, FloatArray]:
    """Derivative of readings by shifts along x, y, z, turns about them, and sizes of lengths, (n, n_rows, 10) each.

    The sizes are those of all lengths (`length_derivative`), positions from the middle of the points, and of positions
    along x, y and z. Along one axis they are as predicted: those of a planar robot would be noise alone.
    """
    result, points, fit = dict[str, FloatArray](), _points(setting), setting.fit
    lengths = length_derivative(fit.robot, fit.configurations, setting.data.readings)
    for name, readings in setting.data.readings.items():
        instrument = setting.fit.robot.instrument(name)
        result[name] = columns = np.zeros((len(readings), instrument.n_rows, 10))
        rows = _position_rows(instrument)
        columns[:, :, 6] = lengths[name]
        if len(rows) == 3:
            columns[:, rows, :3] = np.eye(3)
        if name in points:
            columns[:, rows, 3:6] = np.cross(points[name][:, None], np.eye(3)).swapaxes(1, 2)
            columns[:, rows, 6] = points[name]
            predicted = points[name] + np.nan_to_num(setting.fit.identification.after[name][:, rows])
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
    for name, readings in setting.data.readings.items():
        points = setting.fit.robot.instrument(name).points(readings.values)
        if points is not None and len(points) and len(_position_rows(setting.fit.robot.instrument(name))) == 3:
            result[name] = points
    if not result:
        return {}
    middle = np.nanmean(np.concatenate(list(result.values())), axis=0)
    return {name: np.nan_to_num(points - middle) for name, points in result.items()}


def _seen_targets(setting: EffectSetting) -> Iterator[tuple[str, str, list[int]]]:
    """Yield each instrument that measures the position of a target, its target and the rows of the position."""
    for name in setting.data.readings:
        instrument = setting.fit.robot.instrument(name)
        rows = _position_rows(instrument)
        if len(rows) == 3 and isinstance(instrument, FrameInstrument):
            yield name, instrument.target, rows


def _other_joints(robot: Robot, target: str) -> list[int]:
    """Return the joints that move, but do not move this target, as indices of their frames."""
    mechanism = robot.mechanism
    frame = mechanism.targets[robot.target_names.index(target)].b
    moving = np.any(mechanism.select_moving, axis=1)
    return [int(k) + 1 for k in np.flatnonzero(moving & (mechanism.support[frame] == 0))]


def _moved_target(setting: EffectSetting, target: str) -> list[FloatArray]:
    """Return the entry of a target in `EffectSetting.moved_targets`."""
    robot, all_readings = setting.fit.robot, setting.data.readings
    seen = [(name, rows, robot.pairs[name]) for name, own, rows in _seen_targets(setting) if own == target]
    links = [None, *_other_joints(robot, target)]
    frame_pairs = [
        pair if link is None else replace(pair, b=link) for link in links for _, _, pairs in seen for pair in pairs
    ]
    poses = iter(relative_poses(robot.mechanism, setting.fit.configurations, tuple(frame_pairs)))
    changes = []
    for _ in links:
        result: dict[str, FloatArray] = {
            name: np.zeros((len(readings), robot.instrument(name).n_rows, 3)) for name, readings in all_readings.items()
        }
        for name, rows, pairs in seen:
            readings, turned = all_readings[name], np.stack([next(poses) for _ in pairs])[..., :3, :3]
            result[name][:, rows] = -turned[readings.pairs, readings.visits]
        changes.append(setting.whiten(result))
    return changes


def _curves(values: FloatArray) -> FloatArray:
    """Legendre polynomials of degree 1 to 3 over the range of some values (n,), as factors of one effect, (n, 1, 3)."""
    x = 2 * (values - values.min()) / (float(np.ptp(values)) or 1.0) - 1
    return np.stack([x, (3 * x**2 - 1) / 2, (5 * x**3 - 3 * x) / 2], axis=1)[:, None]
