"""Meaning of the numbers of pairs: units, form of the rotations, frames, signs and order.

Every reading is tried on the nominal robot, with the best base and tool (`calib.matching.alignment`). The right reading
leaves the errors of the robot's origins, some millimetres; a wrong reading leaves a part of the workspace. Candidates
are: joint values in degrees and radians; all forms of rotations (`calib.matching.pairs`); the tool in the base,
the base in the tool, and inverse rotations alone. If none of them fits, twists are tried: joint 3 counted from the
horizontal (joint 2 is in it), joint values some rows above or below their poses, columns of positions in another order
or with another sign, and columns of joint values with other order, sign, zero or scale
(`calib.core.fitting.column_maps`).

A header breaks ties and is compared with the result; it decides nothing by itself.

When it fails. Two twists at once; a twist in inverse poses.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import DataError
from calib.core.base.units import PER_SI, from_unit, quantity_text
from calib.core.base.words import count_noun, listing
from calib.core.data.in_memory import as_measurements
from calib.core.fitting.column_maps import likely_maps
from calib.core.robots.robot import Robot
from calib.matching.alignment import Alignment, align, turns_apart
from calib.matching.pairs import CONVENTIONS, HEADERS, Convention, Pairs

_SAME = 1e-9  # differences of joint values and poses that count as zero [m], [rad]
_FINEST = 1e-6  # finest own rounding of a controller [m or rad]
_FIT = 0.08  # a reading fits if it misses by less than this part of the spread of the robot's positions
_STILL = 0.005  # pairs determine nothing if the robot's positions spread less [m]
_ALIKE = 3.0  # a fit must decide if another miss is less than this many times the best
_SHORT = 12  # number of readings kept for each joint unit and direction: six sequences agree equally
_TURNED = 1e-4  # rotations agree equally if their misfits differ less, squared errors of robots [rad^2]
_MIRRORED = 4  # best readings whose columns of positions are tried in other orders
_MOST = 4  # largest number of readings that fits decide between
_SHIFTS = (-3, -2, -1, 1, 2, 3)
_TURN = 4.5 * np.pi  # joint values above this are no radians
_DIRECTIONS = {
    "direct": "the tool in the base",
    "inverse": "the base seen from the tool (inverse poses)",
    "turned": "positions of the tool in the base, rotations inverse",
}


@dataclass(frozen=True, eq=False)
class Twist:
    """A deviation from the usual meaning of a file.

    Attributes:
        words: The deviation in words; empty: none.
        joints: A of joint values A q + b, q as in the file, (n_joints, n_joints); None: identity.
        zeros: b, (n_joints,) [m or rad].
        shift: Number of rows by which the joint values are below their poses.
        positions: Matrix from columns of positions to x, y, z, (3, 3).
    """

    words: str = ""
    joints: FloatArray | None = None
    zeros: FloatArray | float = 0.0
    shift: int = 0
    positions: FloatArray | None = None


_NONE = Twist()


@dataclass(frozen=True, eq=False)
class Interpretation:
    """A meaning of the numbers.

    Attributes:
        convention: Convention of rotations.
        joint_units: Unit of each joint.
        length_unit, angle_unit: Units of positions, and of the rotations' angles.
        direction: Key of `_DIRECTIONS`.
        twist: A further deviation from the usual meaning.
    """

    convention: Convention
    joint_units: tuple[str, ...]
    length_unit: str
    angle_unit: str
    direction: str = "direct"
    twist: Twist = _NONE

    @property
    def joint_scales(self) -> FloatArray:
        """Factors from numbers of the file to joint values, (n_joints,) [m or rad per 1]."""
        return np.array([from_unit(1.0, unit) for unit in self.joint_units])

    def joints(self, numbers: FloatArray) -> FloatArray:
        """Return joint values (n, n_joints) [m or rad] from the file's numbers (n, n_joints)."""
        q: FloatArray = numbers * self.joint_scales
        return q if self.twist.joints is None else q @ self.twist.joints.T + self.twist.zeros

    def poses(self, positions: FloatArray, rotations: FloatArray) -> FloatArray:
        """Return T_base_tool, (n, 4, 4) [m], from the file's numbers (n, 3) and (n, k)."""
        T = np.tile(np.eye(4), (len(positions), 1, 1))
        columns = positions if self.twist.positions is None else positions @ self.twist.positions.T
        T[:, :3, 3] = from_unit(columns, self.length_unit)
        T[:, :3, :3] = self.convention.rotation(from_unit(rotations, self.angle_unit)).as_matrix()
        if self.direction == "turned":
            T[:, :3, :3] = T[:, :3, :3].swapaxes(1, 2)
        return np.linalg.inv(T) if self.direction == "inverse" else T

    def select_pairs(self, pairs: Pairs) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return joint values (n, n_joints) with their positions and rotations (n, k), in the units of the file."""
        ahead, behind = max(self.twist.shift, 0), max(-self.twist.shift, 0)
        n = len(pairs) - ahead - behind
        q, other = slice(ahead, ahead + n), slice(behind, behind + n)
        return pairs.joints[q], pairs.positions[other], pairs.rotations[other]

    def values(self, pairs: Pairs) -> tuple[FloatArray, FloatArray]:
        """Return joint values (n, n_joints) [m or rad] and T_base_tool, (n, 4, 4) [m]."""
        joints, positions, rotations = self.select_pairs(pairs)
        return self.joints(joints), self.poses(positions, rotations)

    def steps(self, pairs: Pairs) -> FloatArray:
        """Return the rounding steps of joints, positions and rotations, (n_joints + 2,), in units of the file.

        They are at least a controller's own rounding.
        """
        pose = [from_unit(1.0, unit) for unit in (self.length_unit, self.angle_unit)]
        return np.maximum(pairs.steps, _FINEST / np.append(self.joint_scales, pose))

    def words(self) -> str:
        """Return the reading in words."""
        unit = f" in {self.angle_unit}" if self.convention.has_angles else ""
        joints = listing(list(dict.fromkeys(self.joint_units)), " and ")
        text = f"joints in {joints}, positions in {self.length_unit}, rotations as {self.convention}{unit}"
        return f"{text}; {_DIRECTIONS[self.direction]}"

    def mistakes(self, pairs: Pairs) -> list[str]:
        """Return the differences of the file from its header, or from the usual meaning."""
        names = [*("joint values" for _ in self.joint_units), "positions", "rotations"]
        columns = zip(names, pairs.units, (*self.joint_units, self.length_unit, self.angle_unit), strict=True)
        differences = (each for each in columns if each[1] not in (None, each[2]))
        found = [f"{what} are in {unit}, not in {stated}" for what, stated, unit in dict.fromkeys(differences)]
        meant = HEADERS.get(pairs.words)
        if meant and meant != self.convention.form:
            found.append(f"the columns {pairs.words} are not {meant}, but {self.convention.form}")
        found += [f"poses are {_DIRECTIONS[self.direction]}"] * (self.direction != "direct")
        return found + [self.twist.words] * bool(self.twist.words)


@dataclass(frozen=True)
class PlacedInterpretation:
    """A reading with its base and tool."""

    reading: Interpretation
    aligned: Alignment


def candidates(robot: Robot, pairs: Pairs) -> list[PlacedInterpretation]:
    """Return the readings that fit the nominal robot, the best first; several if only a fit can decide.

    Raises:
        DataError: No reading fits, or several fit equally; see `alike_error`.
    """
    usual = _likeliest(robot, pairs, [_NONE], _DIRECTIONS)
    tried = _place(robot, pairs, usual)
    points = nominal_poses(robot, usual[0].joints(pairs.joints))[:, :3, 3]
    spread = float(np.sqrt(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=1))))
    if spread < _STILL:
        raise DataError(
            f"{pairs.path}: the tool moves by {quantity_text(spread, 'mm', '.1f')} only (RMS,"
            f" {count_noun(len(pairs), 'pair')}); add pairs in which all joints turn far"
        )
    limit = _FIT * spread
    for readings in _single_twists(robot, pairs, usual):
        if min(one.aligned.rms_distance for one in tried) <= limit:
            break
        tried += _place(robot, pairs, readings)
    best = min(tried, key=lambda one: one.aligned.rms_distance)
    least = best.aligned.rms_distance
    if least > limit:
        raise DataError(
            f"{pairs.path}: no reading of the columns brings the poses near {robot.path}; the nearest"
            f" ({best.reading.words()}) leaves {quantity_text(least, 'mm', '.0f')}. Check that it is this robot, that"
            " all rows have one tool and one base, and that joint values and pose of a row belong together"
        )
    alike: list[PlacedInterpretation] = []
    for one in sorted(tried, key=lambda one: (len(one.reading.mistakes(pairs)), one.aligned.rms_distance)):
        near = one.aligned.rms_distance < min(_ALIKE * least, limit)
        if near and not any(_are_same(pairs, one.reading, other.reading) for other in alike):
            alike.append(one)
    if len(alike) > _MOST and HEADERS.get(pairs.words):
        alike = [one for one in alike if not one.reading.mistakes(pairs)] or alike
    if len(alike) > _MOST:
        raise alike_error(pairs, [one.reading for one in alike])
    return alike


def alike_error(pairs: Pairs, readings: Sequence[Interpretation]) -> DataError:
    """Return the error for several readings that fit equally."""
    words = listing([reading.words() for reading in readings], " | ", shown=_MOST)
    return DataError(
        f"{pairs.path}: several readings of the columns fit equally well: {words}; write units and the maker's column"
        " names into the header (qw, W P R, A B C, [deg]), or add pairs in which the tool is turned more"
    )


def nominal_poses(robot: Robot, joints: FloatArray) -> FloatArray:
    """Return the poses of the target's link, (n, 4, 4) [m]."""
    return robot.forward(joints, robot.description.targets[robot.target_names[0]].frame)


def _are_same(pairs: Pairs, one: Interpretation, other: Interpretation) -> bool:
    """Whether two readings give the same joint values and poses in this file."""
    values, others = one.values(pairs), other.values(pairs)
    return len(values[0]) == len(others[0]) and all(
        np.allclose(mine, theirs, atol=_SAME) for mine, theirs in zip(values, others, strict=True)
    )


def _place(robot: Robot, pairs: Pairs, readings: Iterable[Interpretation]) -> list[PlacedInterpretation]:
    """The readings with their alignments; those that give the same poses share one."""
    alignments: dict[bytes, Alignment] = {}
    placed = []
    for reading in readings:
        joints, printed = reading.values(pairs)
        poses = np.stack([nominal_poses(robot, joints), printed])
        key = (np.round(poses / _SAME) + 0.0).tobytes()  # 0.0 makes zeros of both signs one
        if key not in alignments:
            alignments[key] = align(*poses)
        placed.append(PlacedInterpretation(reading, alignments[key]))
    return placed


def _likeliest(
    robot: Robot, pairs: Pairs, twists: Sequence[Twist], directions: Iterable[str] = ("direct",)
) -> list[Interpretation]:
    """The readings whose rotations agree best with the robot's, which needs neither tool nor base.

    Some of each joint unit and direction are kept, since small rotations are proportional in any unit, and all that
    agree equally: if the tool turns about one axis, this is any axis.
    """
    ranked: list[tuple[float, Interpretation]] = []
    for start, direction in product(_plain(robot, pairs), directions):
        group = []
        for twist in twists:
            twisted = replace(start, twist=twist, direction=direction)
            robots = nominal_poses(robot, twisted.values(pairs)[0])[:, :3, :3]
            for convention, unit in product(CONVENTIONS, ("deg", "rad")):
                if convention.width == pairs.rotations.shape[1] and (convention.has_angles or unit == "rad"):
                    one = replace(twisted, convention=convention, angle_unit=unit)
                    group.append((turns_apart(robots, one.values(pairs)[1][:, :3, :3]), one))
        group.sort(key=lambda entry: entry[0])
        ranked += [each for k, each in enumerate(group) if k < _SHORT or each[0] < group[0][0] + _TURNED]
    return [reading for _, reading in sorted(ranked, key=lambda entry: entry[0])]


def _plain(robot: Robot, pairs: Pairs) -> list[Interpretation]:
    """A reading for each possible unit of joint values, with positions in the unit of the robot's size."""
    dimensions = [robot.mechanism.dimensions[name] for name in robot.joint_names]
    points = robot.forward(robot.sample(50, 0), robot.target_names[0])[:, :3, 3]
    reach, size = (float(np.median(np.linalg.norm(xyz, axis=1))) for xyz in (points, pairs.positions))
    length = min(("mm", "m"), key=lambda unit: abs(np.log(from_unit(max(size, _SAME), unit) / reach)))
    first = next(each for each in CONVENTIONS if each.width == pairs.rotations.shape[1])
    units = [{"angle": unit, "length": length} for unit in ("deg", "rad")]
    ways = [tuple(usual[each] for each in dimensions) for usual in units]
    headers = zip(dimensions, pairs.units, strict=False)  # units of joints come first
    stated = [unit if unit in PER_SI[each] else None for each, unit in headers]
    ways += [tuple(unit or own for unit, own in zip(stated, way, strict=True)) for way in ways]
    large = np.max(np.abs(pairs.joints), axis=0) > _TURN
    return [
        Interpretation(first, way, length, "rad")
        for way in dict.fromkeys(ways)
        if not np.any(large & (np.array(way) == "rad"))
    ]


def _single_twists(robot: Robot, pairs: Pairs, usual: Sequence[Interpretation]) -> Iterator[Iterable[Interpretation]]:
    """Readings with one twist, kind by kind."""
    names, n = robot.joint_names, len(robot.joint_names)
    coupled = []
    for sign, word in ((1.0, "plus"), (-1.0, "minus")) if n >= 3 else ():
        A = np.eye(n)
        A[2, 1] = sign
        why = f"counts {names[2]} from the horizontal (as FANUC does): in the URDF it is this {word} {names[1]}"
        coupled.append(Twist(f"the controller {why}", A))
    yield _likeliest(robot, pairs, coupled)
    descriptions = {shift: f"{count_noun(abs(shift), 'row')} {'below' if shift > 0 else 'above'}" for shift in _SHIFTS}
    shifted = [
        Twist(f"joint values stand {descriptions[k]} their poses", shift=k) for k in _SHIFTS if len(pairs) > 3 + abs(k)
    ]
    yield _likeliest(robot, pairs, shifted)
    direct = [each for each in usual[:_MIRRORED] if each.direction == "direct"]
    yield (replace(each, twist=twist) for twist in _mirror_twists() for each in direct)
    for one in _plain(robot, pairs):
        positions = one.poses(pairs.positions, pairs.rotations)[:, :3, 3]
        mapped = []
        for at in likely_maps(robot, as_measurements(robot, one.joints(pairs.joints), positions)):
            zeros = at.joints(np.zeros((1, n)))[0]
            mapped.append(Twist(at.words(robot), (at.joints(np.eye(n)) - zeros).T, zeros))
        yield [each for each in _likeliest(robot, pairs, mapped) if each.joint_units == one.joint_units]


def _mirror_twists() -> Iterator[Twist]:
    for axes, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        if (axes, signs) != ((0, 1, 2), (1.0, 1.0, 1.0)):
            columns = ", ".join(f"{'-' * (sign < 0)}{'xyz'[k]}" for k, sign in zip(axes, signs, strict=True))
            words = f"the columns x, y, z of positions hold {columns}"
            yield Twist(words, positions=np.array(signs)[:, None] * np.eye(3)[list(axes)])
