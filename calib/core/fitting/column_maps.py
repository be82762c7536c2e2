"""Mistakes in the columns of joint values: wrong order of the columns, wrong sign, zero or scale of a joint.

Every joint value is an affine map of one column of the file, q = a x + b. Mistakes may be in the order of the columns
(any order), the sign, the zero (quarter turns) and the scale (any factor from 0.4 to 2.5, and units). There may be
several mistakes, and correcting one of three need not reduce the error. So all orders, all patterns of signs, and any
two other changes are tried. From the best few, the joints are changed one by one, as long as this halves the error.
Maps are compared by a lower bound of the error that needs no iteration: an unknown rotation of the base may be any
matrix, so that base and target follow from one linear system.

When it fails. The poses of robots with loops are expensive to close. For these robots, only single mistakes are tried
(an order, a zero or a scale), and one or two signs. A map that takes joints beyond their limits is left out. Scales are
found to some percent; `calib.core.fitting.likely_mistakes` finds them by a fit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, islice, permutations, product

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray
from calib.core.base.units import MappedColumn, mapped_column, per_si
from calib.core.base.words import joints_named
from calib.core.data.measurements import Measurements
from calib.core.numerics import linalg
from calib.core.robots.robot import Robot

USUAL_FACTORS: dict[str, dict[float, str]] = {
    "angle": {
        0.9: "gon read as degrees",
        math.radians(1): "degrees read as radians",
        math.degrees(1): "radians read as degrees",
        1e-3: "mrad read as rad",
        1e3: "rad read as mrad",
        360.0: "turns read as degrees",
        360.0 / 4096: "counts of 4096 a turn read as degrees",
    },
    "length": {1e-3: "mm read as m", 1e3: "m read as mm", 25.4: "inches read as mm", 0.0254: "inches read as m"},
}
"""Usual causes of a wrong scale, by the dimension of the joint and the factor that corrects the column."""
_STEP = 0.06  # relative step between tried scales
_STILL = 0.05  # a smaller factor, of no usual cause, means that the joint moves nothing that was read
_USUAL = 2e-3  # relative difference of a factor from a usual one
_FACTORS = tuple((1.0 + _STEP) ** k for k in range(-16, 17) if k)
_ALL_SIGNS = 8  # with more motors, not every pattern of signs and not every two changes are tried
_ALL_ORDERS = 5040  # if there are more orders, only those of two or three columns are tried
_BEAM = 6  # best maps that are changed further
_ROUNDS = 4
_HALVED = 0.5
_SAME = 1e-6
_MIRRORED = 0.1  # size of a negative determinant that no noise explains
_MARGIN = 0.1  # a map may take joints of a robot with loops this far beyond their limits [m or rad]


@dataclass(frozen=True, order=True)
class ColumnMap:
    """Values of the actuated joints from the columns x of a file: factor * x[column] + quarter turns.

    Attributes:
        columns: Index of the column of each actuated joint.
        factors: Factor of each actuated joint.
        quarters: Number of quarter turns that are added to each actuated joint.
    """

    columns: tuple[int, ...]
    factors: tuple[float, ...]
    quarters: tuple[int, ...]

    @classmethod
    def plain(cls, n: int) -> ColumnMap:
        """Return the map of a file without mistakes."""
        return cls(tuple(range(n)), (1.0,) * n, (0,) * n)

    def joints(self, x: FloatArray) -> FloatArray:
        """Return joint values of the robot for the file's values x, (n_poses, n_actuated) each."""
        return x[:, self.columns] * np.array(self.factors) + np.array(self.quarters) * (np.pi / 2)

    def with_factor(self, j: int, factor: float) -> ColumnMap:
        """Return the map with another factor of joint j."""
        return replace(self, factors=(*self.factors[:j], factor, *self.factors[j + 1 :]))

    def with_quarter(self, j: int, quarter: int) -> ColumnMap:
        """Return the map with another number of quarter turns of joint j."""
        return replace(self, quarters=(*self.quarters[:j], quarter, *self.quarters[j + 1 :]))

    def with_columns(self, joints: Sequence[int], columns: Sequence[int]) -> ColumnMap:
        """Return the map with other columns of some joints."""
        changed = dict(zip(joints, columns, strict=True))
        return replace(self, columns=tuple(changed.get(j, column) for j, column in enumerate(self.columns)))

    @property
    def changes(self) -> int:
        """Number of wrong signs, zeros and scales, plus the number of misplaced columns minus 1."""
        moved = sum(k != column for k, column in enumerate(self.columns))
        of_joints = sum((f < 0) + (abs(f) != 1) + (z != 0) for f, z in zip(self.factors, self.quarters, strict=True))
        return of_joints + max(moved - 1, 0)

    @property
    def is_scaled(self) -> bool:
        """Whether a factor is not one."""
        return any(abs(factor) != 1 for factor in self.factors)

    def still_joints(self, robot: Robot) -> list[int]:
        """Return the joints with a factor near zero, which no unit has: these joints do not move the target."""
        dimensions = [robot.mechanism.dimensions[name] for name in robot.joint_names]
        small = [j for j, factor in enumerate(self.factors) if abs(factor) < _STILL]
        return [j for j in small if not _usual(abs(self.factors[j]), 0.0, dimensions[j])]

    def words(self, robot: Robot, std: Sequence[float] = ()) -> str:
        """Return the mistakes in words; `std` are standard deviations of the factors, where these are known."""
        names, turned, still = robot.joint_names, [], self.still_joints(robot)
        moved = [k for k, column in enumerate(self.columns) if k != column]
        parts = [_order_in_words([names[k] for k in moved], [names[self.columns[k]] for k in moved])] * bool(moved)
        for j, (name, factor, quarter) in enumerate(zip(names, self.factors, self.quarters, strict=True)):
            if abs(factor) == 1 and not quarter:
                turned += [name] * (factor < 0)
                continue
            scaled, why = abs(factor) != 1, ""
            value = f"{abs(factor):.4g} * {name}" if scaled else name
            if quarter:
                value = f"{value} {90 * quarter:+d} deg" if factor > 0 else f"{90 * quarter} deg - {value}"
            elif factor < 0:
                value = f"-{value}"
            how = ["counted from another zero"] * bool(quarter)
            if scaled:
                size = std[j] if std else _STEP * abs(factor) / 2
                why = _usual(abs(factor), size, robot.mechanism.dimensions[name])
                if j in still:
                    parts.append(
                        f"the target does not move with {joints_named(name)}, as if it sat on a link before it"
                    )
                    continue
                how.insert(0, f"was scaled by {1 / abs(factor):.4g} +- {2 * size / factor**2:.1g}")
            parts.append(f"{joints_named(name)} {' and '.join(how)} ({value} would be right{why})")
        if turned:
            have = "has" if len(turned) == 1 else "have"
            parts.insert(bool(moved), f"{joints_named(*turned, shown=len(turned))} {have} the wrong sign")
        return " and ".join(parts)

    def description_line(self, robot: Robot, units: Mapping[str, str | None]) -> str:
        """Return the line of the robot's description that corrects the mistakes: `columns: {elbow: "-elbow [deg]"}`.

        The line includes the maps that the description already has.

        Args:
            units: Units of the file's columns, by name.
        """
        known = {
            mapped_column(text).name: (key, mapped_column(text)) for key, text in robot.description.columns.items()
        }
        entries, names = [], robot.joint_names
        for name, k, factor, quarter in zip(names, self.columns, self.factors, self.quarters, strict=True):
            if names[k] == name and factor == 1 and not quarter:
                continue
            dimension = robot.mechanism.dimensions[name]
            key, column = known.get(names[k], (names[k], MappedColumn(names[k], None)))
            unit = column.unit or units.get(key) or ("rad" if dimension == "angle" else "m")
            offset = factor * column.offset + (quarter * np.pi / 2 * per_si(unit, "angle", key) if quarter else 0.0)
            size = factor * column.factor
            text = f"{'-' if size < 0 else ''}{'' if abs(size) == 1 else f'{abs(size):.6g} * '}{name}"
            shift = f" {'+' if offset > 0 else '-'} {abs(offset):.6g}" if offset else ""
            entries.append(f'{key}: "{text}{shift} [{unit}]"')
        return f"columns: {{{', '.join(entries)}}}"


def _usual(factor: float, size: float, dimension: str) -> str:
    """The usual cause of a column's factor, if there is one within three times `size`; else empty."""
    near = (
        text for usual, text in USUAL_FACTORS[dimension].items() if abs(factor / usual - 1) < _USUAL + 3 * size / usual
    )
    return next((f", as of {text}" for text in near), "")


def _order_in_words(names: Sequence[str], columns: Sequence[str]) -> str:
    """A clause that says which columns were swapped, or in which other order they were."""
    if len(names) == 2:
        return f"the columns of {joints_named(*names, separator=' and ')} were swapped"
    where = ", ".join(f"{name} in that of {column}" for name, column in zip(names, columns, strict=True))
    return f"the columns of {joints_named(*names, shown=len(names))} were in another order ({where})"


def likely_maps(robot: Robot, data: Measurements) -> list[ColumnMap]:
    """Return the likeliest mistakes in columns of joint values, from a few measurements that the robot does not fit."""
    return list(_maps_with_loops(robot, data) if robot.mechanism.loops else _search_maps(robot, data))


def _turns(at: ColumnMap, turning: BoolArray) -> Iterator[ColumnMap]:
    for j, factor in enumerate(at.factors):
        turned = at.with_factor(j, -factor)
        yield turned
        for quarter in (-1, 0, 1, 2) if turning[j] else ():
            yield at.with_quarter(j, quarter)
            yield turned.with_quarter(j, quarter)


def _scales(robot: Robot, at: ColumnMap) -> Iterator[ColumnMap]:
    for j, name in enumerate(robot.joint_names):
        for factor in (*_FACTORS, *USUAL_FACTORS[robot.mechanism.dimensions[name]]):
            yield at.with_factor(j, math.copysign(factor, at.factors[j]))


def _orders(robot: Robot) -> Iterator[ColumnMap]:
    """Other orders of the columns of joints of one sort: all, or those that move two or three columns."""
    plain, turning = ColumnMap.plain(len(robot.joint_names)), robot.mechanism.turning
    groups = [np.flatnonzero(turning).tolist(), np.flatnonzero(~turning).tolist()]
    for group in groups:
        if math.factorial(len(group)) <= _ALL_ORDERS:
            orders: Iterator[tuple[tuple[int, ...], tuple[int, ...]]] = ((tuple(group), o) for o in permutations(group))
        else:
            some = [c for size in (2, 3) for c in combinations(group, size)]
            orders = ((chosen, order) for chosen in some for order in permutations(chosen))
        for places, order in orders:
            if places != order:
                yield plain.with_columns(places, order)


def _maps_with_loops(robot: Robot, data: Measurements) -> Iterator[ColumnMap]:
    n = len(robot.joint_names)
    lower, upper = robot.urdf.limits(robot.joint_names)
    plain, turning = ColumnMap.plain(n), robot.mechanism.turning
    yield from (plain.with_factor(j, -1.0) for j in range(n))
    pairs = (plain.with_factor(a, -1.0).with_factor(b, -1.0) for a, b in combinations(range(n), 2))
    zeros = (plain.with_quarter(j, k) for j in np.flatnonzero(turning).tolist() for k in (-2, -1, 1, 2))
    for tried in (*pairs, *zeros, *_orders(robot), *_scales(robot, plain)):
        joints = tried.joints(data.joints)
        if np.all((joints > lower - _MARGIN) & (joints < upper + _MARGIN)):
            yield tried


def _search_maps(robot: Robot, data: Measurements) -> Iterator[ColumnMap]:
    """The best maps of the search, those with fewer changes first among equally good ones."""
    n = len(robot.joint_names)
    plain = ColumnMap.plain(n)
    turning = robot.mechanism.turning & _zero_matters(robot, data, plain)
    once = {*_turns(plain, turning)}
    start = {plain, *once, *_orders(robot), *_scales(robot, plain)}
    if n <= _ALL_SIGNS:
        start |= {replace(plain, factors=signs) for signs in product((1.0, -1.0), repeat=n)}
        start |= {other for at in once for other in _turns(at, turning)}
    miss = _bounds(robot, data, sorted(start))
    for _ in range(_ROUNDS):
        best = sorted(miss, key=lambda at: miss[at])[:_BEAM]
        before = miss[best[0]]
        changed = {other for at in best for other in (*_turns(at, turning), *_scales(robot, at))} - miss.keys()
        if not changed:
            break
        miss |= _bounds(robot, data, sorted(changed))
        if min(miss.values()) > _HALVED * before:
            break
    scale = max(min(miss.values()), 1e-6)

    def rank(at: ColumnMap) -> tuple[int, int, float]:
        return round(np.log2(max(miss[at], scale) / scale)), at.changes, miss[at]

    ranked = (at for at in sorted(miss, key=rank) if at.changes and not _is_mirrored(robot, data, at))
    return islice(ranked, _BEAM)


def _zero_matters(robot: Robot, data: Measurements, plain: ColumnMap) -> BoolArray:
    """Whether a quarter turn of each joint's zero changes the bound; an unknown base or target may absorb it."""
    quarters = [plain.with_quarter(j, 1) for j in plain.columns]
    miss, *others = _bounds(robot, data, [plain, *quarters]).values()
    return np.array([abs(other - miss) > _SAME * miss for other in others])


def _bounds(robot: Robot, data: Measurements, maps: Sequence[ColumnMap]) -> dict[ColumnMap, float]:
    """A lower bound of each map's error at the first target, divided by the spread of its positions."""
    factor = np.asarray(np.linalg.qr(_systems(robot, data, maps), mode="r"))
    points = data.points(robot)[:, 0]
    spread = float(np.linalg.norm(points - points.mean(axis=0))) or 1.0
    return {at: float(abs(r[-1, -1])) / spread for at, r in zip(maps, factor, strict=True)}


def _is_mirrored(robot: Robot, data: Measurements, at: ColumnMap) -> bool:
    if robot.description.base.pose != "unknown":
        return False
    system = _systems(robot, data, [at])[0]
    matrix = linalg.lstsq(system[:, :-1], system[:, -1])[:9].reshape(3, 3)
    return bool(np.linalg.det(matrix) < -_MIRRORED)


def _systems(robot: Robot, data: Measurements, maps: Sequence[ColumnMap]) -> FloatArray:
    """The linear system of each map, (n_maps, 3 n_poses, n_unknowns + 1), with the right side as last column.

    An unknown base has twelve unknowns: nine entries of a matrix instead of its rotation, and a translation. An unknown
    target has its position in its link.
    """
    section = robot.description.targets[robot.target_names[0]]
    T = robot.forward(np.concatenate([at.joints(data.joints) for at in maps]), section.frame)
    T = T.reshape(len(maps), len(data), 4, 4)
    measured = data.points(robot)[:, 0]
    explained = T[..., :3, 3].copy()
    parts: list[FloatArray] = []
    if robot.description.base.pose == "unknown":
        matrix = np.einsum("rs,nj->nrsj", np.eye(3), measured - measured.mean(axis=0)).reshape(len(data), 3, 9)
        parts += [np.broadcast_to(part, (*T.shape[:2], 3, part.shape[-1])) for part in (matrix, np.eye(3))]
    else:
        explained -= measured
    if section.position == "unknown":
        parts.append(T[..., :3, :3])
    else:
        explained += T[..., :3, :3] @ np.array(section.xyz)
    return np.concatenate([*parts, explained[..., None]], axis=-1).reshape(len(maps), 3 * len(data), -1)
