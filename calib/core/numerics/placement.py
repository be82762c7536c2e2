"""Placement: unknown poses of the measurement frame and positions of targets.

Problem. A link has the poses (R_i, t_i) in the robot's base link, and one of its points p was seen at m_i from a frame
X = (R, t). There may be several points, on the same or other links, and w_i readings of each. Minimise

    sum w_i |R m_i + t - R_i p - t_i|^2   +   sum noise^2 |p - guess|^2 / sigma^2

Method. For a given R this is linear in t and all p. Once these are eliminated, the residuals are linear in the nine
entries of R, so that all poses shrink into ten rows F vec(R) - f, for every mechanism. Damped Newton steps descend to R
from the rotation nearest to the matrix X that minimises them. A rotation Q with a lower sum than R has |F vec(Q - X)| <
|F vec(R - X)|, and so |F vec(Q - R)| < 2 |F vec(R - X)|. Where this does not prove that every such Q is near R, there
may be several minima: steps descend from each of the 60 rotations of the icosahedron (every rotation is within 45
degrees of one of them), and the lowest end is taken. Where sigma is given, the noise is found from the residuals.

What the poses do not determine stays near the guess. This concerns first the points: a link that never turns does not
determine its point, and a link that turns about one axis only does not separate the point's direction from that of X.
Then it concerns the rotation of X: points on one line, or all in one place. The distances to both guesses get weights
too small to move what is determined, and the last steps omit them.

When it fails. It always gives a result: what is undetermined is the guess. A caller that must know what is determined
computes a rank (`calib.core.numerics.identifiability`). Noise alone can make a direction look determined that the poses
hardly show.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import scipy
from numpy.typing import ArrayLike

from calib.core.base.arrays import BoolArray, FloatArray
from calib.core.base.errors import DataError
from calib.core.numerics import linalg
from calib.core.numerics.identifiability import extend_reduced, reduce_rows
from calib.core.numerics.rigid import cross_matrices, rotations_by
from calib.core.numerics.tall import slices

_TURNS = cross_matrices(np.eye(3))  # [e_k]x
_RANK = 1e-9  # a link that turns less does not determine its point [rad]
_OPEN = 1e-6  # singular values below this part of the largest leave a rotation open
_POINT_WEIGHT, _TURN_WEIGHT = 1e-5, 1e-7  # weights of the distances to the guesses, relative to the measurements
_DESCENDED, _STILL = 1e-6, 1e-11  # a descent, and what finishes it, end with a smaller step [rad]
_NEAR = 0.3  # rotations that differ by less are in one basin (norm of the difference)
_ITERATIONS, _LAST_STEPS, _NOISE_ROUNDS = 80, 8, 20
_RELATIVE, _ABSOLUTE = 1e-2, 1e-12  # the iteration of the noise ends at a smaller change: relative, and in m
_SMALLEST = 1e-3  # extent of the points [m]: below `_OPEN` times this, a turn about them is open


@dataclass(frozen=True, eq=False)
class MovingPoint:
    """A point of a link, measured at several poses of this link.

    Attributes:
        T_base_link: Poses of the link in the base link, (n, 4, 4) [m].
        measured: The point in the measurement frame, (n, 3) [m].
        guess: Expected position in its link, (3,) [m].
        sigma: Standard deviation of the guess along each axis, (3,) [m]: 0 where it is exact, infinite where unknown.
    """

    T_base_link: FloatArray
    measured: FloatArray
    guess: FloatArray
    sigma: FloatArray


@dataclass(frozen=True, eq=False)
class Placement:
    """Pose of the measurement frame, and positions of the points.

    Attributes:
        points: Position of each point in its link, (n_points, 3) [m].
        rms: Root mean square distance between measured and computed points [m].
    """

    T_base_measurement: pin.SE3
    points: FloatArray
    rms: float


def place(
    points: Sequence[MovingPoint],
    counts: ArrayLike,
    guess: pin.SE3,
    *,
    frame_known: bool = False,
    rough_beyond: float = np.inf,
) -> Placement:
    """Find the measurement frame, and points of links, from poses of those links.

    Args:
        points: The points, all seen in the same n poses.
        counts: Number of readings averaged at each pose, (n,).
        guess: Expected pose of the measurement frame in the base link.
        frame_known: Whether the guess is exact, so that only the points are found.
        rough_beyond: If the root mean square error is more [m], the search ends without the distances to the guessed
            points, which could only raise the error.

    Raises:
        DataError: No pose, values that are not finite, or shapes that differ.
    """
    weights = np.asarray(counts, dtype=float)
    for point in points:
        _check(point, weights)
    system = _system(points, weights, guess, frame_known)
    noise, rotation = 0.0, guess.rotation
    for k in range(_NOISE_ROUNDS):
        if not frame_known:
            rotation = _best_rotation(system, noise, guess.rotation, rotation if k else None)
        moved = _eliminate_points(system, noise)[0] @ np.append(rotation, -1.0)
        solution = np.concatenate([moved, -rotation.ravel(), [1.0]])
        squares = float(np.sum((system.rows @ solution) ** 2))
        estimate = float(np.sqrt(squares / max(3 * len(points) * len(weights) - len(moved) - 6 * (not frame_known), 1)))
        if noise == 0.0 and squares > (rough_beyond * system.weight) ** 2:
            break
        if np.all(np.isinf(system.sigma)) or abs(estimate - noise) <= max(_RELATIVE * estimate, _ABSOLUTE):
            break
        noise = estimate
    result = np.array([point.guess for point in points], dtype=float)
    result[system.free] += moved
    translation = guess.translation if frame_known else system.mean @ solution
    return Placement(pin.SE3(rotation, translation), result, float(np.sqrt(squares / weights.sum() / len(points))))


def _check(point: MovingPoint, weights: FloatArray) -> None:
    T, m = point.T_base_link, point.measured
    if m.ndim != 2 or T.shape != (len(m), 4, 4) or m.shape != (len(m), 3) or len(m) == 0 or weights.shape != (len(m),):
        raise DataError(
            f"link poses {T.shape}, measured points {m.shape} and counts {weights.shape} do not belong together;"
            " expected (n, 4, 4), (n, 3) and (n,)"
        )
    if point.guess.shape != (3,) or not np.all(np.isfinite(point.guess)):
        raise DataError(f"guessed point {point.guess}: expected three finite numbers")
    finite = np.isfinite(T).all(axis=(1, 2)) & np.isfinite(m).all(axis=1)
    if not finite.all():
        raise DataError(f"row {int(np.argmin(finite))}: a pose or a measured point is not finite; leave the row out")


@dataclass(frozen=True, eq=False)
class _System:
    """Rows A dp - M vec(R) + s: as many as columns, with the same sum of squares as the rows of all poses.

    Attributes:
        rows: [A M s], (n_rows, n_free + 10).
        mean: Part of all rows that X's translation absorbs, (3, n_free + 10), already subtracted.
        free: Whether each coordinate of the points is unknown, (n_points, 3).
        sigma: Standard deviations of the unknown coordinates, (n_free,) [m].
        extent: Root mean square distance of the measured points from their centre [m].
    """

    rows: FloatArray
    mean: FloatArray
    free: BoolArray
    sigma: FloatArray
    weight: float
    extent: float


def _system(points: Sequence[MovingPoint], weights: FloatArray, guess: pin.SE3, frame_known: bool) -> _System:
    free = np.array([point.sigma > 0 for point in points], dtype=bool)
    n_free, parts = int(free.sum()), list(slices(len(weights)))  # rows of all readings at once take much memory
    mean = np.zeros((3, n_free + 10))
    if frame_known:
        mean[:, -1] = guess.translation
    else:
        sums = (np.einsum("n,jnac->ac", weights[part], _plain_rows(points, free, part)) for part in parts)
        mean += sum(sums) / weights.sum() / len(points)
    factor: FloatArray = np.zeros((0, n_free + 10))
    squares = 0.0
    for part in parts:
        rows = np.sqrt(weights[part])[:, None, None] * (_plain_rows(points, free, part) - mean)
        squares += float(np.sum(rows[..., n_free:-1] ** 2))
        factor = extend_reduced(factor, rows.reshape(-1, n_free + 10))
    extent = float(np.sqrt(squares / weights.sum() / len(points) / 3))
    sigma = np.concatenate([point.sigma[point.sigma > 0] for point in points])
    return _System(factor, mean, free, sigma, float(np.sqrt(weights.sum() * len(points))), extent)


def _plain_rows(points: Sequence[MovingPoint], free: BoolArray, part: slice) -> FloatArray:
    """[A M s] of some readings of each point, (n_points, n, 3, n_free + 10), before `mean` is subtracted."""
    n_free = int(free.sum())
    rows = np.zeros((len(points), part.stop - part.start, 3, n_free + 10))
    for j, point in enumerate(points):
        first, poses = int(free[:j].sum()), point.T_base_link[part]
        turns = poses[:, :3, :3]
        rows[j, :, :, first : first + int(free[j].sum())] = turns[:, :, free[j]]
        for axis in range(3):
            rows[j, :, axis, n_free + 3 * axis : n_free + 3 * axis + 3] = point.measured[part]
        rows[j, :, :, -1] = turns @ point.guess + poses[:, :3, 3]
    return rows


def _eliminate_points(system: _System, noise: float, weak: float = 0.0) -> tuple[FloatArray, FloatArray]:
    """Return [D d] with the shortest best dp = D vec(R) - d, (n_free, 10), and the remaining rows [F f], (n, 10).

    Every |dp| has at least the weight `weak`.
    """
    n_free = len(system.sigma)
    distances = np.zeros((n_free, n_free + 10))
    distances[:, :n_free] = np.diag(np.maximum(noise / system.sigma, weak))
    rows = np.vstack([system.rows, distances])
    left, values, right = linalg.svd(rows[:, :n_free], full_matrices=False)
    determined = values > _RANK * system.weight
    left, inverse = left[:, determined], right[determined].T / values[determined]
    coordinates = left.T @ rows[:, n_free:]
    return inverse @ coordinates, rows[:, n_free:] - left @ coordinates


def _best_rotation(system: _System, noise: float, guess: FloatArray, near: FloatArray | None) -> FloatArray:
    """Return the rotation (3, 3) with the smallest sum of squares, for a noise [m].

    Where the system leaves it open, it stays near the `guess` (3, 3). `near` is that for a similar noise, if known.
    """
    _, searched = _eliminate_points(system, noise, _POINT_WEIGHT * system.weight)
    turn = _TURN_WEIGHT * system.weight * max(system.extent, _SMALLEST)
    to_guess = turn * np.column_stack([np.eye(9), guess.ravel()])
    rows = reduce_rows(np.vstack([searched, to_guess]))
    left, values, right = linalg.svd(rows[:, :9], full_matrices=False)
    free = right.T @ (left.T @ rows[:, 9] / values)  # X of the module docstring
    u, _, v = linalg.svd(free.reshape(3, 3))
    u[:, 2] *= np.linalg.det(u @ v)
    ends, squares = _descend(rows, (u @ v if near is None else near)[None])
    if 2.0 * np.linalg.norm(rows[:, :9] @ (ends[0].ravel() - free)) > _NEAR * values[-1]:
        group = scipy.spatial.transform.Rotation.create_group("I").as_matrix()
        ends, squares = _descend(rows, np.concatenate([[guess], group]))
    return _finish_descent(system, noise, ends[np.argmin(squares)])


def _finish_descent(system: _System, noise: float, rotation: FloatArray) -> FloatArray:
    """Return the rotation (3, 3) at the end of a descent, refined without the small weights of guesses."""
    _, exact = _eliminate_points(system, noise)
    least, by_turn = _OPEN * system.weight * _SMALLEST, _turned_rows(exact[:, :9])
    for _ in range(_LAST_STEPS):
        right, values, left = linalg.svd((rotation.ravel() @ by_turn).reshape(3, -1), full_matrices=False)
        determined = values > max(_OPEN * values[0], least)
        error = exact @ np.append(rotation, -1.0)
        step = right[:, determined] @ ((left @ error)[determined] / values[determined])
        rotation = rotation @ pin.exp3(-step)
        if np.linalg.norm(step) < _STILL:
            break
    return rotation


def _descend(rows: FloatArray, starts: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Minimise |rows [vec(R); -1]|^2 over rotations from all starts (n, 3, 3) at once; return ends and minima (n,).

    With R exp(w), errors e and slope J, half of the sum has the gradient J^T e and the second derivative

        J^T J + (M + M^T) / 2 - tr(M) I,        M = R^T G,        G the gradient F^T e by R, as a matrix,

    because the second order of exp is [w]x^2 / 2 = (w w^T - w^T w I) / 2. The last two terms are omitted where the sum
    is not positive definite.
    """
    F, f = rows[:, :9], rows[:, 9]
    ends, last = starts.copy(), starts.reshape(-1, 9) @ F.T - f
    damping, moving, by_turn = np.full(len(starts), 1e-2), np.arange(len(starts)), _turned_rows(F)
    for _ in range(_ITERATIONS):
        rotations, errors = ends[moving], last[moving]
        slope = (rotations.reshape(-1, 9) @ by_turn).reshape(len(moving), 3, -1)  # J^T
        square = slope @ slope.transpose(0, 2, 1)
        size = np.trace(square, axis1=1, axis2=2)
        twice = rotations.transpose(0, 2, 1) @ (errors @ F).reshape(-1, 3, 3)
        bend = (twice + twice.transpose(0, 2, 1)) / 2 - np.trace(twice, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        square += np.where(_positive(square + bend)[:, None, None], bend, 0.0)
        square += ((damping[moving] + 1e-16) * size + 1e-300)[:, None, None] * np.eye(3)
        steps = -np.linalg.solve(square, slope @ errors[..., None])[..., 0]
        tried = rotations @ rotations_by(steps)
        trial_errors = tried.reshape(-1, 9) @ F.T - f
        better = np.sum(trial_errors**2, axis=1) < np.sum(errors**2, axis=1)
        ends[moving[better]], last[moving[better]] = tried[better], trial_errors[better]
        damping[moving] *= np.where(better, 0.1, 10.0)
        moving = moving[np.linalg.norm(steps, axis=1) >= _DESCENDED]
        if len(moving) == 0:
            break
    return ends, np.sum(last**2, axis=1)


def _positive(square: FloatArray) -> BoolArray:
    """Whether symmetric matrices (n, 3, 3) are positive definite: their leading minors are positive, (n,)."""
    first, both = square[:, 0, 0], square[:, 0, 0] * square[:, 1, 1] - square[:, 0, 1] ** 2
    positive: BoolArray = (first > 0) & (both > 0) & (np.linalg.det(square) > 0)
    return positive


def _turned_rows(F: FloatArray) -> FloatArray:
    """Return the matrix (9, 3 n_rows) that turns vec(R) into d(F vec(R exp(w)))/dw at w = 0, axis by axis."""
    return (F.reshape(-1, 3, 3) @ _TURNS[:, None].swapaxes(-1, -2)).reshape(-1, 9).T
