"""What joint values mean: signs and zeros that would make measurements fit, and whether whole turns are counted.

Joints may count the other way, or from another zero. Several may be wrong at once, and one put right among three wrong
ones need not help: all patterns of signs are tried, and any two changes; from the best few of them zeros and signs are
changed one by one, as long as that halves the miss. Patterns are compared by a lower bound of the miss that needs no
iteration: where the base is unknown, its rotation may be any matrix, so that base and target follow from one linear
system. `joint_changes` yields the best patterns; the caller compares the nominal robot under each.

When it fails. Robots with loops, whose poses are expensive to close: there one or two signs or one zero are tried, and
of more than one sign only where the joints stay within their limits.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations, islice, product

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray
from calib.core.base.words import joints_named, listed
from calib.core.data.measurements import Measurements
from calib.core.numerics import linalg
from calib.core.robots.robot import Robot

_ALL_SIGNS = 8  # motors up to which every pattern of signs and every two changes are tried
_BEAM = 6  # best patterns that are changed further
_ROUNDS = 4
_HALVED = 0.5
_SAME = 1e-6
_MIRRORED = 0.1  # size of a negative determinant that no noise explains
_FILLED = 0.75  # part of a turn beyond which values are so near to both of its ends that they may be wrapped there
_ROUND = 1e-3  # beyond the ends of a turn, values that were rounded [rad]
_MARGIN = 0.1  # beyond a joint's limit, of a robot with loops [m or rad]

Pattern = tuple[tuple[int, ...], tuple[int, ...]]
"""Signs, and quarter turns to add, of every motor."""


def joint_changes(robot: Robot, data: Measurements) -> Iterator[tuple[int, str, Measurements]]:
    """Yield the likeliest mistakes of joint signs and zeros: how many, in words, and the measurements without them.

    Args:
        robot: The nominal robot.
        data: A few measurements that do not fit it.
    """
    patterns = _tried_with_loops(robot, data) if robot.mechanism.loops else _searched(robot, data)
    for pattern in patterns:
        yield _size(pattern), _words(robot, pattern), replace(data, joints=_joints(data.joints, pattern))


def _turning(robot: Robot) -> BoolArray:
    return np.array([robot.mechanism.dimensions[name] == "angle" for name in robot.joint_names])


def _joints(q: FloatArray, pattern: Pattern) -> FloatArray:
    """Joint values of the robot where the file has q."""
    signs, quarters = pattern
    return q * np.array(signs) + np.array(quarters) * (np.pi / 2)


def _words(robot: Robot, pattern: Pattern) -> str:
    turned, parts = [], []
    for name, sign, quarter in zip(robot.joint_names, *pattern, strict=True):
        degrees = 90 * quarter
        if quarter:
            right = f"{name} {degrees:+d} deg" if sign > 0 else f"{degrees} deg - {name}"
            parts.append(f"{joints_named(name)} counted from another zero ({right} would be right)")
        elif sign < 0:
            turned.append(name)
    if turned:
        parts.insert(0, f"{joints_named(*turned, shown=len(turned))} counted the other way")
    return " and ".join(parts)


def _size(pattern: Pattern) -> int:
    """Number of changes."""
    return sum(sign < 0 for sign in pattern[0]) + sum(quarter != 0 for quarter in pattern[1])


def _single_changes(pattern: Pattern, turning: BoolArray) -> Iterator[Pattern]:
    signs, quarters = pattern
    for j in range(len(signs)):
        yield _with(signs, j, -signs[j]), quarters
        for quarter in (-1, 0, 1, 2) if turning[j] else ():
            yield signs, _with(quarters, j, quarter)
            yield _with(signs, j, -signs[j]), _with(quarters, j, quarter)


def _with(values: tuple[int, ...], j: int, value: int) -> tuple[int, ...]:
    return (*values[:j], value, *values[j + 1 :])


def _tried_with_loops(robot: Robot, data: Measurements) -> Iterator[Pattern]:
    n = len(robot.joint_names)
    lower, upper = robot.urdf.limits(robot.joint_names)
    signs, quarters = (1,) * n, (0,) * n
    for j in range(n):
        yield _with(signs, j, -1), quarters
    pairs = [(_with(_with(signs, a, -1), b, -1), quarters) for a, b in combinations(range(n), 2)]
    turning = [j for j, turns in enumerate(_turning(robot)) if turns]
    zeros = [(signs, _with(quarters, j, quarter)) for j in turning for quarter in (-2, -1, 1, 2)]
    for pattern in pairs + zeros:
        joints = _joints(data.joints, pattern)
        if np.all((joints > lower - _MARGIN) & (joints < upper + _MARGIN)):
            yield pattern


def _searched(robot: Robot, data: Measurements) -> list[Pattern]:
    """The best patterns that the search meets, those with fewer changes first among equals."""
    n = len(robot.joint_names)
    plain = (1,) * n, (0,) * n
    turning = _turning(robot) & _zero_matters(robot, data, plain)
    once = set(_single_changes(plain, turning))
    start = {plain} | once
    if n <= _ALL_SIGNS:
        start |= {(signs, plain[1]) for signs in product((1, -1), repeat=n)}
        start |= {other for pattern in once for other in _single_changes(pattern, turning)}
    miss = _bounds(robot, data, sorted(start))
    for _ in range(_ROUNDS):
        best = sorted(miss, key=lambda pattern: miss[pattern])[:_BEAM]
        before = miss[best[0]]
        changed = {other for pattern in best for other in _single_changes(pattern, turning)} - miss.keys()
        if not changed:
            break
        miss |= _bounds(robot, data, sorted(changed))
        if min(miss.values()) > _HALVED * before:
            break
    scale = max(min(miss.values()), 1e-6)

    def rank(pattern: Pattern) -> tuple[int, int, float]:
        return round(np.log2(max(miss[pattern], scale) / scale)), _size(pattern), miss[pattern]

    ranked = (pattern for pattern in sorted(miss, key=rank) if _size(pattern) and not _mirrored(robot, data, pattern))
    return list(islice(ranked, _BEAM))


def _zero_matters(robot: Robot, data: Measurements, plain: Pattern) -> BoolArray:
    """Of which motors a quarter turn of the zero changes the bound; an unknown base or target takes up the others."""
    quarters = [(plain[0], _with(plain[1], j, 1)) for j in range(len(plain[0]))]
    miss, *others = _bounds(robot, data, [plain, *quarters]).values()
    return np.array([abs(other - miss) > _SAME * miss for other in others])


def _bounds(robot: Robot, data: Measurements, patterns: Sequence[Pattern]) -> dict[Pattern, float]:
    """A lower bound of each pattern's miss of the first target, over the spread of its positions."""
    factor = np.asarray(np.linalg.qr(_systems(robot, data, patterns), mode="r"))
    points = data.points(robot)[:, 0]
    spread = float(np.linalg.norm(points - points.mean(axis=0))) or 1.0
    return {pattern: float(abs(r[-1, -1])) / spread for pattern, r in zip(patterns, factor, strict=True)}


def _mirrored(robot: Robot, data: Measurements, pattern: Pattern) -> bool:
    """Whether a pattern's bound belongs to a left-handed measurement frame."""
    if robot.description.base.pose != "unknown":
        return False
    system = _systems(robot, data, [pattern])[0]
    matrix = linalg.lstsq(system[:, :-1], system[:, -1])[:9].reshape(3, 3)
    return bool(np.linalg.det(matrix) < -_MIRRORED)


def _systems(robot: Robot, data: Measurements, patterns: Sequence[Pattern]) -> FloatArray:
    """The linear system of each pattern, (n_patterns, 3 n_poses, n_unknowns + 1), what they explain in the last column.

    Unknowns are the nine entries of any matrix for the rotation to the base link and a translation, where the base is
    unknown, and the point in its link, where that is.
    """
    section = robot.description.targets[robot.target_names[0]]
    T = robot.forward(np.concatenate([_joints(data.joints, pattern) for pattern in patterns]), section.frame)
    T = T.reshape(len(patterns), len(data), 4, 4)
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
    return np.concatenate([*parts, explained[..., None]], axis=-1).reshape(len(patterns), 3 * len(data), -1)


def uncounted_turns(robot: Robot, joints: FloatArray) -> list[str]:
    """Return the joints that turn without end whose values (n_poses, n_actuated) fill one turn, and leave none.

    Values that are wrapped look so: how often the joint had turned is then not known.
    """
    endless = {joint.name for joint in robot.urdf.joints if joint.type == "continuous"}
    turn, within = 2.0 * np.pi, np.zeros(joints.shape[1], dtype=bool)
    for least in (-np.pi, 0.0):
        within |= (joints.min(axis=0) > least - _ROUND) & (joints.max(axis=0) < least + turn + _ROUND)
    filled = within & (np.ptp(joints, axis=0) > _FILLED * turn)
    return [name for name, wrapped in zip(robot.joint_names, filled, strict=True) if wrapped and name in endless]


def may_be_wrapped(joints: Sequence[str], wrong: Sequence[str]) -> str:
    """Return what is wrong, and what to do, where the values of some joints may be wrapped.

    Args:
        joints: The joints.
        wrong: What follows them and counts turns.
    """
    return (
        f"all values of {joints_named(*joints)} lie within one turn, and the URDF"
        f" states no limits. If these values were wrapped, {listed(wrong)} cannot be right. Give values that count"
        " turns; or give limits, if the joint turns no further; or use harmonics or a curve, which repeat with the"
        " turn"
    )


def wrapped_terms(robot: Robot, joints: FloatArray) -> tuple[str, ...]:
    """Say what is wrong with joint terms that count turns of joints whose values (n_poses, n_actuated) may not."""
    uncounted = uncounted_turns(robot, joints)
    followed = [
        (term.followed(robot.joint_names), term.parameters[0].name) for term in robot.terms if term.counts_turns
    ]
    wrong = {name: joint for joint, name in followed if joint in uncounted}
    return (may_be_wrapped(list(dict.fromkeys(wrong.values())), list(wrong)),) if wrong else ()
