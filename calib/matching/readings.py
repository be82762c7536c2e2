"""What the numbers of pairs mean: units, form of the rotations, which frame is seen from which, signs and order.

Every reading is tried on the nominal robot, base and tool placed as well as possible (`calib.matching.alignment`). The
right one leaves what the robot's origins are off, some millimetres; a wrong one leaves a part of the workspace. Tried
are: joint values in degrees and radians; all angles about three axes, fixed or moving, rotation vectors, quaternions
with the scalar first or last; the tool seen from the base, the base from the tool, and rotations alone inverse. Only
where none of them fits: joint 3 counted from the horizontal (joint 2 is in it), joint values some rows above or below
their poses, columns of positions in another order or with another sign, and columns of joint values with other order,
sign, zero or scale (`calib.core.fitting.column_maps`).

What a header says breaks ties and is compared with what was found; it decides nothing by itself.

When it fails. Mistakes of two of the latter kinds at once; joint values wrong in poses that are inverse.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, permutations, product

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import DataError
from calib.core.base.units import PER_SI, millimetres
from calib.core.base.words import listed
from calib.core.data.in_memory import as_measurements
from calib.core.fitting.column_maps import ColumnMap, likely_maps
from calib.core.robots.robot import Robot
from calib.matching.alignment import Alignment, align, turns_apart
from calib.matching.pairs import Pairs

_SAME = 1e-9  # difference of joint values and poses that is none [m], [rad]
_FINEST = 1e-6  # digit of a number below which a controller rounds by itself [m or rad]
_FIT = 0.08  # miss over the spread of the robot's positions, below which a reading fits
_ALIKE = 3.0  # miss over that of the best, up to which a fit has to decide
_SHORT = 12  # readings of each choice of units and direction whose rotations agree best: six sequences agree alike
_MIRRORED = 4  # likeliest readings whose columns of positions are tried in other orders
_MOST = 4  # readings that fits decide between
_SHIFTS = (-3, -2, -1, 1, 2, 3)
_REACH = (0.02, 3.0)  # size of the positions over that of the robot's
_TURN = 4.5 * np.pi  # joint values beyond this are no radians
_DIRECTIONS = {
    "direct": "the tool in the base",
    "inverse": "the base seen from the tool (inverse poses)",
    "turned": "positions of the tool in the base, rotations inverse",
}
_MAKERS = {"xyz": "FANUC's W P R, roll pitch yaw", "ZYX": "KUKA's A B C", "XYZ": "Stäubli's rx ry rz", "ZYZ": "O A T"}
_VECTOR = "rotation vector"
_QUATERNIONS = {"qx qy qz qw": (0, 1, 2, 3), "qw qx qy qz": (1, 2, 3, 0)}
_ORDERS = ("XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX", "XYX", "XZX", "YXY", "YZY", "ZXZ", "ZYZ")
_HEADERS = {
    "qx qy qz qw": ("qx qy qz qw",),
    "qw qx qy qz": ("qx qy qz qw", "qw qx qy qz"),  # columns are taken by name: the order that `_ROTATIONS` lists
    "q1 q2 q3 q4": ("qw qx qy qz",),
    "w p r": ("xyz",),
    "a b c": ("ZYX",),
    "o a t": ("ZYZ",),
    "roll pitch yaw": ("xyz",),
    "alpha beta gamma": ("XYZ",),
    "theta x y z": ("xyz",),
}
"""Forms that the words of a header mean."""


@dataclass(frozen=True)
class Reading:
    """One meaning of the numbers.

    Attributes:
        form: Of rotations: a quaternion's order, `rotation vector`, `matrix`, or axes as scipy writes them.
        joint_unit, length_unit, angle_unit: Of joints that turn, of lengths, and of the rotations' angles.
        direction: Key of `_DIRECTIONS`.
        map: Of which column each joint is, with sign, zero and scale; None: as they stand.
        coupled: Sign with which joint 2 is added to joint 3; 0 for none.
        shift: By how many rows the joint values stand below their poses.
        axes, signs: Which columns x, y, z of positions are, and their signs.
    """

    form: str
    joint_unit: str
    length_unit: str
    angle_unit: str
    direction: str = "direct"
    map: ColumnMap | None = None
    coupled: float = 0.0
    shift: int = 0
    axes: tuple[int, ...] = (0, 1, 2)
    signs: tuple[float, ...] = (1.0, 1.0, 1.0)

    def joint_scales(self, robot: Robot) -> FloatArray:
        """Return what makes numbers of the file joint values, (n_joints,) [m or rad]."""
        dimensions = [robot.mechanism.dimensions[name] for name in robot.joint_names]
        units = {"angle": 1 / PER_SI["angle"][self.joint_unit], "length": 1 / PER_SI["length"][self.length_unit]}
        return np.array([units[dimension] for dimension in dimensions])

    def joints(self, robot: Robot, numbers: FloatArray) -> FloatArray:
        """Return joint values (n, n_joints) [m or rad] of the file's numbers (n, n_joints)."""
        q: FloatArray = numbers * self.joint_scales(robot)
        q = q if self.map is None else self.map.joints(q)
        if self.coupled:
            q[:, 2] += self.coupled * q[:, 1]
        return q

    def poses(self, positions: FloatArray, rotations: FloatArray) -> FloatArray:
        """Return T_base_tool, (n, 4, 4) [m], of the file's numbers (n, 3) and (n, k)."""
        T = np.tile(np.eye(4), (len(positions), 1, 1))
        T[:, :3, 3] = positions[:, self.axes] * np.array(self.signs) / PER_SI["length"][self.length_unit]
        T[:, :3, :3] = _rotation(self.form, rotations / PER_SI["angle"][self.angle_unit]).as_matrix()
        if self.direction == "turned":
            T[:, :3, :3] = T[:, :3, :3].swapaxes(1, 2)
        return np.linalg.inv(T) if self.direction == "inverse" else T

    def paired(self, pairs: Pairs) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return joint values (n, n_joints) and the numbers of positions and rotations that belong to them (n, k) each.

        All in the units of the file.
        """
        ahead, behind = max(self.shift, 0), max(-self.shift, 0)
        n = len(pairs) - ahead - behind
        q, other = slice(ahead, ahead + n), slice(behind, behind + n)
        return pairs.joints[q], pairs.positions[other], pairs.rotations[other]

    def steps(self, robot: Robot, pairs: Pairs) -> FloatArray:
        """Return the last digits of joints, positions and rotations, none finer than a controller's own rounding.

        In units of the file, (n_joints + 2,).
        """
        pose = (1 / PER_SI["length"][self.length_unit], 1 / PER_SI["angle"][self.angle_unit])
        return np.maximum(pairs.steps, _FINEST / np.append(self.joint_scales(robot), pose))

    def words(self) -> str:
        """Return the reading in words."""
        rotations = (
            f"rotations as {self.form} ({_said(self.form)})" if _said(self.form) else f"rotations as {self.form}"
        )
        unit = "" if self.form in _QUATERNIONS or self.form == "matrix" else f" in {self.angle_unit}"
        text = f"joints in {self.joint_unit}, positions in {self.length_unit}, {rotations}{unit}"
        return f"{text}; {_DIRECTIONS[self.direction]}"

    def mistakes(self, robot: Robot, pairs: Pairs) -> list[str]:
        """Return in what the file is not as its header, or as most files are."""
        said = zip(("joint values", "positions", "rotations"), pairs.units,
                   (self.joint_unit, self.length_unit, self.angle_unit), strict=True)  # fmt: skip
        found = [f"{what} are in {unit}, not in {stated}" for what, stated, unit in said if stated not in (None, unit)]
        meant = _HEADERS.get(pairs.words, (self.form,))
        if self.form not in meant:
            found.append(f"the columns {pairs.words} are not {meant[0]}, but {self.form}")
        if self.direction != "direct":
            found.append(f"poses are {_DIRECTIONS[self.direction]}")
        if self.map is not None:
            found.append(self.map.words(robot))
        if self.coupled:
            names = robot.joint_names
            sign = "plus" if self.coupled > 0 else "minus"
            found.append(
                f"the controller counts {names[2]} from the horizontal (as FANUC does): the robot's is its number"
                f" {sign} {names[1]}"
            )
        if self.shift:
            side = "below" if self.shift > 0 else "above"
            found.append(f"joint values stand {abs(self.shift)} rows {side} their poses")
        if (self.axes, self.signs) != ((0, 1, 2), (1.0, 1.0, 1.0)):
            columns = ", ".join(f"{'-' * (sign < 0)}{'xyz'[k]}" for k, sign in zip(self.axes, self.signs, strict=True))
            found.append(f"the columns x, y, z of positions hold {columns}")
        return found


def _said(form: str) -> str:
    if form == _VECTOR:
        return "UR's rx ry rz"
    if form in _MAKERS:
        return f"angles about {'moving' if form.isupper() else 'fixed'} axes, {_MAKERS[form]}"
    return f"angles about {'moving' if form.isupper() else 'fixed'} axes" if form.upper() in _ORDERS else ""


def _rotation(form: str, numbers: FloatArray) -> scipy.spatial.transform.Rotation:
    of = scipy.spatial.transform.Rotation
    if form == _VECTOR:
        return of.from_rotvec(numbers.copy())
    if form in _QUATERNIONS:
        return of.from_quat(numbers[:, _QUATERNIONS[form]])
    if form == "matrix":
        return of.from_matrix(numbers.reshape(-1, 3, 3))
    return of.from_euler(form, numbers)


@dataclass(frozen=True)
class Candidate:
    """A reading with the base and tool that it needs."""

    reading: Reading
    aligned: Alignment


def candidates(robot: Robot, pairs: Pairs) -> list[Candidate]:
    """Return the readings that fit the nominal robot, the best first; several where only a fit can tell them apart.

    Args:
        robot: Nominal, its base and target at the links that the controller may mean.
        pairs: The file.

    Raises:
        DataError: None fits, or two fit alike; see `alike_error`.
    """
    simple = list(_simple(robot, pairs))
    short = _shortlist(robot, pairs, simple)
    tried = [_tried(robot, pairs, reading) for reading in short]
    limit = _FIT * _spread(robot, pairs, short[0])
    twisted = (_coupled(robot, simple), _shifted(pairs, simple), _mapped(robot, pairs, simple))
    others: list[Callable[[], Iterable[Reading]]] = [partial(_shortlist, robot, pairs, each) for each in twisted]
    others.append(partial(_mirrored, short[:_MIRRORED]))
    for readings in others:
        if min(tried, key=_miss).aligned.miss <= limit:
            break
        tried += [_tried(robot, pairs, reading) for reading in readings()]
    tried.sort(key=_miss)
    best = tried[0]
    if best.aligned.miss > limit:
        raise DataError(
            f"{pairs.path}: no reading of the columns brings the poses near {robot.path}; the nearest"
            f" ({best.reading.words()}) leaves {millimetres(best.aligned.miss):.0f} mm; is it this robot, with one"
            " tool and one base in all rows, the joint values of one row with its pose?"
        )
    alike: list[Candidate] = []
    for one in sorted(tried, key=lambda one: (len(one.reading.mistakes(robot, pairs)), _miss(one))):
        near = one.aligned.miss < min(_ALIKE * best.aligned.miss, limit)
        if near and not any(_same(robot, pairs, one.reading, other.reading) for other in alike):
            alike.append(one)
    if len(alike) > _MOST:
        raise alike_error(pairs, [one.reading for one in alike])
    return alike


def alike_error(pairs: Pairs, readings: Sequence[Reading]) -> DataError:
    """Return what to raise where several readings fit alike."""
    words = listed([reading.words() for reading in readings], " | ", shown=_MOST)
    return DataError(
        f"{pairs.path}: these readings of the columns fit alike: {words}; write units and the maker's words into the"
        " header (qw, W P R, A B C, [deg]), or add pairs in which the tool is turned more"
    )


def _miss(candidate: Candidate) -> float:
    return candidate.aligned.miss


def _same(robot: Robot, pairs: Pairs, one: Reading, other: Reading) -> bool:
    """Whether two readings mean the same joint values and poses in this file."""
    (q, *pose), (q_other, *pose_other) = one.paired(pairs), other.paired(pairs)
    if len(q) != len(q_other) or not np.allclose(one.joints(robot, q), other.joints(robot, q_other), atol=_SAME):
        return False
    return bool(np.allclose(one.poses(*pose), other.poses(*pose_other), atol=_SAME))


def nominal_poses(robot: Robot, joints: FloatArray) -> FloatArray:
    """Return the poses of the link that the target is on, (n, 4, 4) [m]."""
    return robot.forward(joints, robot.description.targets[robot.target_names[0]].frame)


def _tried(robot: Robot, pairs: Pairs, reading: Reading) -> Candidate:
    joints, positions, rotations = reading.paired(pairs)
    nominal = nominal_poses(robot, reading.joints(robot, joints))
    return Candidate(reading, align(nominal, reading.poses(positions, rotations)))


def _shortlist(robot: Robot, pairs: Pairs, readings: Iterable[Reading]) -> list[Reading]:
    """The readings whose rotations agree best with the robot's, which takes no tool and no base.

    Some of each choice of units and direction: small turns are proportional, in whatever unit.
    """
    of_robot: dict[object, FloatArray] = {}
    printed: dict[object, FloatArray] = {}
    groups: dict[object, list[tuple[float, Reading]]] = {}
    for reading in readings:
        joints, positions, rotations = reading.paired(pairs)
        key = (reading.joint_unit, reading.length_unit, reading.map, reading.coupled, reading.shift)
        if key not in of_robot:
            of_robot[key] = nominal_poses(robot, reading.joints(robot, joints))[:, :3, :3].copy()
        other = (reading.form, reading.angle_unit, reading.direction == "direct", reading.shift)
        if other not in printed:
            printed[other] = reading.poses(positions, rotations)[:, :3, :3].copy()
        apart = turns_apart(of_robot[key], printed[other])
        choice = (reading.joint_unit, reading.length_unit, reading.direction)
        groups.setdefault(choice, []).append((apart, reading))
    ranked = (sorted(group, key=lambda entry: entry[0])[:_SHORT] for group in groups.values())
    return [reading for _, reading in sorted(chain(*ranked), key=lambda entry: entry[0])]


def _spread(robot: Robot, pairs: Pairs, reading: Reading) -> float:
    points = nominal_poses(robot, reading.joints(robot, pairs.joints))[:, :3, 3]
    return float(np.sqrt(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=1))))


def _simple(robot: Robot, pairs: Pairs) -> Iterator[Reading]:
    """Readings in units, forms and directions."""
    width = pairs.rotations.shape[1]
    forms = {3: (_VECTOR, *_ORDERS, *map(str.lower, _ORDERS)), 4: tuple(_QUATERNIONS), 9: ("matrix",)}[width]
    turning = np.array([robot.mechanism.dimensions[name] == "angle" for name in robot.joint_names])
    large = bool(np.any(np.abs(pairs.joints[:, turning]) > _TURN))
    reach = float(
        np.median(np.linalg.norm(robot.forward(robot.sample(50, 0), robot.target_names[0])[:, :3, 3], axis=1))
    )
    size = float(np.median(np.linalg.norm(pairs.positions, axis=1)))
    lengths = [unit for unit in ("mm", "m") if _REACH[0] < size / PER_SI["length"][unit] / reach < _REACH[1]]
    for joint_unit, length_unit in product(("deg",) if large else ("deg", "rad"), lengths or ("mm", "m")):
        for form, direction in product(forms, _DIRECTIONS):
            for angle_unit in ("deg", "rad") if width == 3 else ("rad",):
                yield Reading(form, joint_unit, length_unit, angle_unit, direction)


def _coupled(robot: Robot, simple: list[Reading]) -> Iterator[Reading]:
    """Readings with joint 2 in joint 3."""
    if len(robot.joint_names) >= 3:
        yield from (replace(reading, coupled=sign) for reading in simple for sign in (1.0, -1.0))


def _shifted(pairs: Pairs, simple: list[Reading]) -> Iterator[Reading]:
    """Readings of joint values beside other poses."""
    direct = [reading for reading in simple if reading.direction == "direct"]
    yield from (replace(one, shift=shift) for one in direct for shift in _SHIFTS if len(pairs) - abs(shift) > 3)


def _mapped(robot: Robot, pairs: Pairs, simple: list[Reading]) -> Iterator[Reading]:
    """Readings with other columns, signs, zeros and scales of joint values."""
    direct = [reading for reading in simple if reading.direction == "direct"]
    units = {(reading.joint_unit, reading.length_unit) for reading in direct}
    for joint_unit, length_unit in sorted(units):
        one = Reading(direct[0].form, joint_unit, length_unit, direct[0].angle_unit)
        data = as_measurements(
            robot, one.joints(robot, pairs.joints), one.poses(pairs.positions, pairs.rotations)[:, :3, 3]
        )
        for at in likely_maps(robot, data):
            yield from (
                replace(r, map=at) for r in direct if (r.joint_unit, r.length_unit) == (joint_unit, length_unit)
            )


def _mirrored(readings: list[Reading]) -> Iterator[Reading]:
    """The likeliest readings with columns of positions in another order, or with other signs."""
    for axes, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        if (axes, signs) != ((0, 1, 2), (1.0, 1.0, 1.0)):
            yield from (replace(one, axes=axes, signs=signs) for one in readings if one.direction == "direct")
