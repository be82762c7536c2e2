"""The joint zeros with which the nominal model comes nearest to the calibrated robot.

Wanted are offsets o so that the nominal model, fed with sign * q + o, puts the targets where the robot has them at q,
in least squares over poses. Where the description calls the base or a target unknown, they are placed anew for the
nominal model as well, as its user would do; an error of the base is none of the zeros. The placing is linear to
first order and eliminated by projection, so that an offset that it could take over as well (of a first joint whose axis
the base turns about, of a last joint that only moves an unknown target) stays where it was.

Gauss and Newton's method, with derivatives from central differences. It needs offsets within the reach of a linear
model, a few tenths of a radian, and poses from which nearly all still close with them; the others are left out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import FloatArray
from calib.core.numerics import linalg
from calib.core.robots import kinematics
from calib.core.robots.joint_errors import actual_joints, term_columns
from calib.core.robots.robot import Robot

_STEP = 1e-5  # of joints, for differences [rad or m]
_SMALL = 1e-3  # a change of offsets after which their derivatives still hold [m or rad]
_ROUNDS, _SETTLED = 50, 1e-12  # [m or rad]
_UNDETERMINED = 1e-7
"""Relative singular value below which poses say nothing of a combination of offsets; differences are exacter."""


@dataclass(frozen=True, eq=False)
class JointZeros:
    """Joint zeros, and what they leave.

    Attributes:
        signs: 1, or -1 where a joint counts the other way, (n_joints,).
        offsets: Of sign * q + offset, (n_joints,) [m or rad].
        left, before: Error of each target with them and without them, (n_poses, n_targets) [m]; poses in which one of
            the two robots does not close are not among them.
    """

    signs: FloatArray
    offsets: FloatArray
    left: FloatArray
    before: FloatArray


def joint_zeros(robot: Robot, q: FloatArray, *, fitted: float = 1.0) -> JointZeros:
    """Return the joint zeros that bring the nominal robot nearest.

    Args:
        robot: The robot, with its current values.
        q: Poses, (n, n_joints) [m or rad].
        fitted: Part of the poses, from the first on, from which the offsets are found.
    """
    origins = [robot.mechanism.origin(place) for place in robot.mechanism.places]
    places = {origin: robot.mechanism.placement(origin) for origin in origins}
    bare = robot.with_terms(())
    plain = replace(bare, mechanism=bare.nominal.with_placements(places))
    positions = robot.positions(q)
    actual = actual_joints(robot, q, term_columns(robot, q))[:, : q.shape[1]]
    signs = np.where(np.sum((q - q.mean(axis=0)) * (actual - actual.mean(axis=0)), axis=0) < 0, -1.0, 1.0)
    some = slice(int(np.ceil(fitted * len(q))))
    start = np.mean(actual - signs * q, axis=0)
    offsets, _ = _nearest(plain, signs * q[some], positions[some], start, free=True)
    left = _nearest(plain, signs * q, positions, offsets, free=False)[1]
    before = _nearest(plain, q, positions, np.zeros(len(start)), free=False)[1]
    offsets = np.where(np.abs(offsets) < _SETTLED, 0.0, offsets)
    return JointZeros(signs, offsets, left, before)


def _nearest(
    plain: Robot, q: FloatArray, positions: FloatArray, offsets: FloatArray, *, free: bool
) -> tuple[FloatArray, FloatArray]:
    """Offsets, changed only if they are free, and the distances (n, n_targets) that they and the placing leave."""
    centre: FloatArray = np.mean(positions, axis=(0, 1))
    places = _Places(pin.SE3.Identity(), np.zeros((positions.shape[1], 3)))
    by_zeros: FloatArray = np.zeros((0, 0))
    by_places: FloatArray = np.zeros((0, 0))
    largest = np.inf
    for _ in range(_ROUNDS):
        frames = _frames(plain, q + offsets, centre)
        residual = (places.positions(frames) - (positions - centre)).ravel()
        if largest > _SMALL:  # both derivatives at one point: what they share is eliminated
            by_places = places.derivative(frames, plain)
            by_zeros = _slopes(plain, q + offsets, centre, places) if free else np.zeros((residual.size, len(offsets)))
        finite = np.isfinite(residual) & np.all(np.isfinite(by_zeros), axis=1) & np.all(np.isfinite(by_places), axis=1)
        change, moved = _step(by_zeros[finite], by_places[finite], -residual[finite])
        offsets, places = offsets + change, places.changed(moved, plain)
        largest = float(np.max(np.abs(np.concatenate([change, moved]))))
        if largest < _SETTLED:
            break
    distances = np.linalg.norm(places.positions(_frames(plain, q + offsets, centre)) - (positions - centre), axis=2)
    return offsets, distances[np.all(np.isfinite(distances), axis=1)]


def _step(by_zeros: FloatArray, by_places: FloatArray, change: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least squares of by_zeros x + by_places y = change, with x = 0 wherever y can do it: (x, y)."""
    basis = linalg.orth(by_places) if by_places.size else np.zeros((len(change), 0))
    alone = by_zeros - basis @ (basis.T @ by_zeros)
    left, sizes, right = linalg.svd(alone, full_matrices=False)
    shown = sizes > _UNDETERMINED * np.linalg.norm(by_zeros)  # of the zeros as they are, not of what is left of them
    x = right[shown].T @ ((left[:, shown].T @ change) / sizes[shown])
    y = linalg.lstsq(by_places, change - by_zeros @ x, rcond=_UNDETERMINED)
    return x, y


@dataclass(frozen=True, eq=False)
class _Places:
    """Where base and targets are put anew.

    Attributes:
        base: Motion of all positions, about their centre.
        shifts: Of each target in its link, (n_targets, 3) [m].
    """

    base: pin.SE3
    shifts: FloatArray

    def positions(self, frames: FloatArray) -> FloatArray:
        """Positions of the targets (n, n_targets, 3) from their frames."""
        shifted = frames[..., :3, 3] + np.einsum("ntij,tj->nti", frames[..., :3, :3], self.shifts)
        return shifted @ self.base.rotation.T + self.base.translation

    def derivative(self, frames: FloatArray, robot: Robot) -> FloatArray:
        """By what is unknown: turn and shift of the base, shift of each target, (n coordinates, n_unknowns)."""
        columns = []
        positions = self.positions(frames)
        if robot.description.base.pose == "unknown":
            columns += [np.broadcast_to(axis, positions.shape) for axis in np.eye(3)]
            columns += [np.cross(axis, positions) for axis in np.eye(3)]
        for index, axis in self._shifted(robot):
            column = np.zeros(positions.shape)
            column[:, index] = (frames[:, index, :3, :3] @ axis) @ self.base.rotation.T
            columns.append(column)
        return np.array(columns).reshape(len(columns), positions.size).T

    def changed(self, values: FloatArray, robot: Robot) -> _Places:
        """These places, moved by values in the order of `derivative`."""
        base, shifts, rest = self.base, self.shifts.copy(), values
        if robot.description.base.pose == "unknown":
            base, rest = pin.SE3(pin.exp3(values[3:6]), values[:3]) * base, values[6:]
        for (index, axis), value in zip(self._shifted(robot), rest, strict=True):
            shifts[index] += value * axis
        return _Places(base, shifts)

    @staticmethod
    def _shifted(robot: Robot) -> list[tuple[int, FloatArray]]:
        """Target and axis of each shift that is unknown."""
        targets = robot.description.targets
        unknown = [k for k, name in enumerate(robot.target_names) if targets[name].position == "unknown"]
        return [(k, axis) for k in unknown for axis in np.eye(3)]


def _slopes(robot: Robot, q: FloatArray, centre: FloatArray, places: _Places) -> FloatArray:
    """Derivative of all coordinates by the joints, (n coordinates, n_joints)."""
    ends = []
    for step in _STEP * np.eye(q.shape[1]):
        after, before = (places.positions(_frames(robot, q + s, centre)) for s in (step, -step))
        ends.append((after - before).ravel() / (2 * _STEP))
    return np.column_stack(ends)


def _frames(robot: Robot, q: FloatArray, centre: FloatArray) -> FloatArray:
    """Frames of the targets about a centre, (n, n_targets, 4, 4); NaN where a loop does not close."""
    mechanism = robot.mechanism
    loops = robot.close(q)
    ok = loops.ok
    frames = np.full((len(q), len(mechanism.targets), 4, 4), np.nan)
    closed = robot.assemble(q[ok], loops.passive[ok])
    swept = kinematics.sweep(mechanism, mechanism.all_joints(closed.actuated, closed.passive), mechanism.targets)
    frames[ok] = np.stack([kinematics.relative_pose(swept, target) for target in mechanism.targets], axis=1)
    frames[..., :3, 3] -= centre
    return frames
