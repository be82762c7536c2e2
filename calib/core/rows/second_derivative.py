"""How the identification Jacobian changes with parameters: exactly, for positions that an open chain carries.

Let p be the position of frame b seen from frame a. What parameters do to it enters at places on the way from a to b: at
an origin, or at the joint behind it, whose error a joint term is. There a parameter moves all that follows on the way,
by a twist [v; w] in the axes of a (the other way round where the way leads towards the root), and

    dp / df = d_f = v_f + w_f x p
    d2p / de df = w_e x d_f                    e before f on the way, as e turns what f does

So it is of two parameters k <= l of one origin, k being before l (l before k where the way leads towards the root),
once it is added that the twist xi_l changes with k. How, only the parametrisation knows. It takes no poses, so that it
is a difference:

    d2p / dk dl  +=  dp/dxi . d xi_l / dk

Lengths turn nothing: only angles come first. With J the whitened rows of all readings and W what whitens them,

    G_kl = J^T W d2p / dk dl

is one product for all pairs and some poses, of which the sum is kept.

When it fails. Loops, readings that are no positions, and gravity whose direction is found bend in other ways, too.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray, IntArray, as_slice
from calib.core.instruments.kind import Readings
from calib.core.instruments.position import Position
from calib.core.numerics.tall import in_parts
from calib.core.robots import kinematics
from calib.core.robots.acceleration import compiled_for
from calib.core.robots.configurations import Configurations
from calib.core.robots.joint_errors import driven_by
from calib.core.robots.mechanism import RelativeFrame
from calib.core.robots.robot import Robot
from calib.core.rows.jacobian import joint_twists, parameter_twists, sweeps
from calib.core.rows.rows import Rows
from calib.core.rows.whitening import Whitening

_AT_ONCE = 256  # poses, of which all pairs stay in the processor's cache
_STEP = 1e-6  # of a difference of twists, which are smooth [m or rad]


@dataclass(frozen=True, eq=False)
class Bends:
    """G of the module docstring.

    Attributes:
        pulled: What it is made of, (n_columns, n_bends).
        places: Where that belongs among all pairs of parameters: G_kl is the sum of k, l and l, k, (n_bends, n * n).
        n: Number of parameters.
    """

    pulled: FloatArray
    places: scipy.sparse.csr_array
    n: int

    def times(self, matrix: FloatArray) -> FloatArray:
        """Return a matrix (m, n_columns) times G of all pairs, (m, n, n)."""
        folded = np.asarray((matrix @ self.pulled) @ self.places).reshape(-1, self.n, self.n)
        return folded + folded.transpose(0, 2, 1)


def bend_simply(robot: Robot, whitening: Whitening) -> bool:
    """Whether `bends` has all that bends: no loop closes, and readings are positions."""
    positions = all(isinstance(robot.instrument(name), Position) for name in whitening.layout.instruments)
    return positions and not robot.mechanism.loops and not robot.turns_gravity


def bends(
    robot: Robot,
    configurations: Configurations,
    readings: Mapping[str, Readings],
    rows: Rows,
    whitening: Whitening,
    groups: FloatArray,
    index: IntArray,
) -> Bends:
    """Return G of some parameters, where these `bend_simply`.

    Args:
        robot: The robot.
        configurations: Its assembled visits.
        readings: Of each instrument, by name.
        rows: The whitened rows, without whitening for shared errors.
        whitening: What whitened them.
        groups: Scale of the noise of each group, (n_groups,).
        index: The parameters, in rising order, (n,).
    """
    changes, pulled, places = _changes(robot, index), [], []
    scale = whitening.row_scale(groups)[:, None]
    for name, own in readings.items():
        for number in np.unique(own.pairs).tolist():
            way = _Way(robot, robot.pairs(robot.instrument(name))[number], index, changes)
            total = np.zeros((rows.jacobian.shape[1], way.places.shape[0]))
            with compiled_for(len(own)):
                for chosen, bent in way.along(configurations, own.visits, np.flatnonzero(own.pairs == number)):
                    where = as_slice(rows.layout.rows_of_readings(name, chosen))
                    own_rows = (rows.jacobian[where] / scale[where]).reshape(*bent.shape[:2], -1)
                    pulling = whitening.whitened(name, own_rows, as_slice(chosen), in_place=True, across=True)  # W^T J
                    total += pulling.reshape(-1, len(total)).T @ bent.reshape(-1, total.shape[1])
            pulled.append(total)
            places.append(way.places)
    return Bends(np.hstack(pulled), scipy.sparse.vstack(places, format="csr"), len(index))


def _changes(robot: Robot, index: IntArray) -> FloatArray:
    """Derivative of the origin twists of parameter l by k, for k <= l, half of it for k = l, (6 n_joints, n, n)."""
    twists, n = parameter_twists(robot), len(index)
    own = np.flatnonzero(index < robot.n_origin_parameters)
    result = np.zeros((len(twists), n, n))
    for k in own:
        values = robot.values.copy()
        values[index[k]] += _STEP
        change = (parameter_twists(robot, values) - twists) / _STEP
        result[:, k, own] = change[:, index[own]] * np.where(own > k, 1.0, np.where(own < k, 0.0, 0.5))
    return result


class _Way:
    """What parameters do on the way from frame a to frame b.

    Args:
        robot: The robot.
        pair: The frames.
        index: The parameters, (n,).
        changes: From `_changes`.

    Attributes:
        places: As of `Bends`.
    """

    def __init__(self, robot: Robot, pair: RelativeFrame, index: IntArray, changes: FloatArray) -> None:
        self._mechanism, self._pair = robot.mechanism, pair
        signs, n = robot.mechanism.between(pair), len(index)
        entries = [entry for entry in _entries(robot, index) if signs[entry.joint]]
        entries.sort(key=lambda entry: _order(entry, signs[entry.joint]))
        units = np.flatnonzero(np.repeat(signs != 0, 6) & np.any(changes, axis=(1, 2)))
        self._n_entries, n_twists = len(entries), len(entries) + len(units)
        self._joints = np.array([entry.joint for entry in entries] + (units // 6).tolist(), dtype=np.intp)
        twists = np.zeros((robot.mechanism.n_joints, 6, n_twists))
        for column, entry in enumerate(entries):
            twists[entry.joint, :, column] = entry.twist
        twists[units // 6, units % 6, np.arange(len(entries), n_twists)] = 1.0
        before = robot.mechanism.twists_before(twists.reshape(-1, n_twists) * signs[self._joints])
        self._twists = before[self._joints, :, np.arange(n_twists)]
        self._coefficients = [(e, entry.coefficient) for e, entry in enumerate(entries) if entry.coefficient]
        self._first = np.flatnonzero(np.any(self._twists[: len(entries), 3:] != 0.0, axis=1))
        pairs = _pairs([entry.column for entry in entries], self._first.tolist(), n)
        changed = scipy.sparse.csr_array(changes[units].reshape(len(units), n * n))
        self.places = scipy.sparse.vstack([pairs, changed], format="csr")

    def along(
        self, configurations: Configurations, visits: IntArray, chosen: IntArray
    ) -> Iterator[tuple[IntArray, FloatArray]]:
        """Yield some of the chosen readings (n,), and what bends there, (n_some, 3, n_bends).

        Args:
            configurations: Assembled visits.
            visits: Visit of each reading, (n_readings,).
            chosen: Those along this way.
        """
        for some in in_parts(len(chosen)):
            at = configurations.at(as_slice(visits[chosen[some]]))
            for part, swept in sweeps(self._mechanism, at, (self._pair,)):
                motion = self._motion(swept, at.at(part).term_columns)
                for few in in_parts(len(motion), _AT_ONCE):
                    yield chosen[some][part][few], self._bent(motion[few])

    def _motion(self, swept: kinematics.Sweep, phi: tuple[FloatArray, ...]) -> FloatArray:
        """Return d and w of each twist, (n, 6, n_twists).

        Args:
            swept: Of some visits.
            phi: Of each joint term there.
        """
        joints = np.searchsorted(swept.reduced.joints, self._joints)
        world = kinematics.WorldTwists(swept.reduced, joints, self._twists).seen(swept)
        for e, (term, moved, coefficient) in self._coefficients:
            world[:, :, e] *= phi[term][:, moved, coefficient, None]
        return np.matmul(kinematics.motion_map(swept, (self._pair,), angular=True), world)

    def _bent(self, motion: FloatArray) -> FloatArray:
        """Return d2p of pairs of parameters, then dp by twists that change with them, (n, 3, n_bends)."""
        end, start = self._n_entries, 0
        result = np.empty((len(motion), 3, self.places.shape[0]))
        for e in self._first.tolist():
            x, y, z = (motion[:, k, e:end] for k in range(3))
            u, v, w = (motion[:, k, e, None] for k in range(3, 6))
            to = result[:, :, start : start + end - e]
            to[:, 0] = v * z - w * y  # `np.cross` takes twice as long
            to[:, 1] = w * x - u * z
            to[:, 2] = u * y - v * x
            start += end - e
        result[:, :, start:] = motion[:, :3, end:]
        return result


@dataclass(frozen=True, eq=False)
class _Entry:
    """Where a parameter enters.

    Attributes:
        column: Its place among those that count.
        joint: The origin.
        twist: By which it moves that, or the joint behind it, [linear; angular] in the joint's frame, (6,).
        coefficient: Term, joint and place of its phi, where it is a coefficient of a joint term.
    """

    column: int
    joint: int
    twist: FloatArray
    coefficient: tuple[int, int, int] | None = None


def _entries(robot: Robot, index: IntArray) -> Iterator[_Entry]:
    """Yield where parameters (n,) enter; one of an origin where its twist there is not zero."""
    mechanism, first = robot.mechanism, robot.coefficients.start
    place = {parameter: column for column, parameter in enumerate(index.tolist())}
    twists = parameter_twists(robot).reshape(mechanism.n_joints, 6, -1)
    for joint, parameter in np.argwhere(np.any(twists != 0.0, axis=1)).tolist():
        if parameter in place:
            yield _Entry(place[parameter], joint, twists[joint, :, parameter])
    twists = joint_twists(mechanism).reshape(mechanism.n_joints, 6, -1)
    for number, term in enumerate(robot.terms):
        own = [k for k in range(len(term.parameters)) if first + k in place]
        for moved, driven in enumerate(driven_by(term, mechanism)):
            for joint in np.flatnonzero(np.any(twists[:, :, driven] != 0.0, axis=1)).tolist():
                for k in own:
                    yield _Entry(place[first + k], joint, twists[joint, :, driven], (number, moved, k))
        first += len(term.parameters)


def _order(entry: _Entry, sign: float) -> tuple[float, float]:
    """Where an entry is on a way: an origin before the joint behind it; after it, where the way leads to the root."""
    return sign * (2 * entry.joint + (entry.coefficient is not None)), sign * entry.column


def _pairs(columns: Sequence[int], first: Sequence[int], n: int) -> scipy.sparse.csr_array:
    """Places among all pairs of n parameters of those of entries and what follows each, half for both the same.

    Args:
        columns: Parameter of each entry.
        first: Entries that turn what follows.
        n: Number of parameters.
    """
    pairs = [(e, f) for e in first for f in range(e, len(columns))]
    halves = np.array([0.5 if e == f else 1.0 for e, f in pairs])
    where = np.array([n * columns[e] + columns[f] for e, f in pairs], dtype=np.intp)
    return scipy.sparse.csr_array((halves, (np.arange(len(pairs)), where)), shape=(len(pairs), n * n))
