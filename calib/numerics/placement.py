"""Where frames and points are that nobody measured: the world from nests, the measurement frame, the measured point.

`world_from_nests` is a rigid fit (`calib.numerics.rigid`) with names, repeats and outliers.

`place_base_and_target`. A link has the poses T_i in the robot's base link, and one of its points p was seen at m_i from
a frame X: X m_i = T_i p, with X and p unknown. For any p the best X is a rigid fit. Two values of p are tried: the
guess, and the solution of R m_i + t - R_i p = t_i with the nine entries of R left free, which is linear, so that the
guess may be wrong by more than the robot's size. The better one starts a least-squares solution for X and p together.
What the poses cannot tell (all of p, where the link never turns) stays at the guess.

References: kabsch1976, umeyama1991.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from calib.errors import DataError, nearest
from calib.model.mechanism import FloatArray
from calib.numerics.rigid import RigidFit, best_transform, checked_points, cross_matrices, rigid_fit

__all__ = ["RigidFit", "WorldFrame", "place_base_and_target", "place_target", "rigid_fit", "world_from_nests"]

_RANK = 1e-9  # singular values below this part of the largest are zero


@dataclass(frozen=True, eq=False)
class WorldFrame:
    """The world frame found from nests that are fixed to the robot.

    Attributes:
        fit: Rigid fit from the instrument's frame to the world; its covariance is the frame's uncertainty.
        outliers: Names of nests that do not fit.
        excluded: Names of nests that were left out on request.
        repeatability: Standard deviation of one reading about its nest's mean, per axis; NaN without repeats [m].
    """

    fit: RigidFit
    outliers: tuple[str, ...]
    excluded: tuple[str, ...]
    repeatability: float


def world_from_nests(
    nominal: ArrayLike,
    measured: ArrayLike,
    sigma: float | None = None,
    *,
    names: Sequence[str] | None = None,
    exclude: Sequence[str] = (),
) -> WorldFrame:
    """Find the world frame from nests at known places on the robot, seen by an instrument in its own frame.

    `fit.apply` turns readings of the instrument into world coordinates. Nests that do not fit are reported, and left
    out only when they are named in `exclude`.

    Args:
        nominal: Nests in the world, (n, 3) [m].
        measured: Nests in the instrument's frame, (n, 3), or (n, n_repeats, 3) to be averaged [m].
        sigma: Noise of one component of `measured` (of its means, where repeats are given) [m]; estimated if not given.
        names: Names of the nests; `nest 1`, ... if not given.
        exclude: Names of nests to leave out.

    Raises:
        DataError: As for `rigid_fit`; an unknown name in `exclude`; points that fit only as a mirror image.
    """
    seen, known = np.asarray(measured, dtype=float), np.asarray(nominal, dtype=float)
    repeatability = float("nan")
    if seen.ndim == 3:
        if seen.shape[1] > 1:
            repeatability = float(np.sqrt(np.mean(np.var(seen, axis=1, ddof=1))))
        seen = seen.mean(axis=1)
    labels = list(names) if names is not None else [f"nest {k + 1}" for k in range(len(known))]
    if seen.shape != known.shape or len(labels) != len(known) or len(set(labels)) != len(labels):
        raise DataError(
            f"{len(known)} nests, {len(seen)} measured, {len(set(labels))} different names; each nest needs"
            " its place (x, y, z), its reading and a name of its own"
        )
    for name in exclude:
        if name not in labels:
            raise DataError(f"no nest '{name}' to leave out{nearest(name, labels)}")
    kept = np.array([name not in exclude for name in labels], dtype=bool)
    used = [name for name in labels if name not in exclude]
    fit = rigid_fit(seen[kept], known[kept], sigma, names=used)
    _refuse_mirror(seen[kept], known[kept], fit)
    return WorldFrame(fit, tuple(used[k] for k in fit.outliers), tuple(exclude), repeatability)


def _refuse_mirror(seen: FloatArray, known: FloatArray, fit: RigidFit) -> None:
    """Raise where points that do not fit would fit as a mirror image."""
    rotation, translation = best_transform(-seen, known)
    mirrored = float(np.sqrt(np.mean(np.sum((known + seen @ rotation.T - translation) ** 2, axis=1))))
    if fit.rms > 1e-3 and mirrored < 0.1 * fit.rms:
        raise DataError(
            f"the nests fit to {1e3 * mirrored:.3g} mm only as a mirror image ({1e3 * fit.rms:.3g} mm as"
            " they are); an axis has the wrong sign, or two columns are swapped"
        )


def place_base_and_target(
    T_base_link: ArrayLike, measured: ArrayLike, guess: ArrayLike, *, point_known: bool = False
) -> tuple[pin.SE3, FloatArray]:
    """Find the measurement frame, and the measured point of a link, from poses of that link.

    Args:
        T_base_link: Poses of the link that carries the point in the base link, (n, 4, 4) [m].
        measured: The point in the measurement frame, (n, 3) [m].
        guess: About where the point is in its link, (3,) [m]; an error of decimetres does no harm.
        point_known: `guess` is right; find the measurement frame alone.

    Returns:
        Pose of the measurement frame in the base link, and the point in its link, (3,) [m].

    Raises:
        DataError: Fewer than three rows, rows on one line, values that are not finite, or shapes that differ.
    """
    T, m = _checked_poses(T_base_link, measured)
    point = np.array(guess, dtype=float)
    if point.shape != (3,) or not np.all(np.isfinite(point)):
        raise DataError(f"guessed point {point}: expected three finite numbers")
    first = _best_frame(T, m, point)
    if point_known:
        return pin.SE3(*first[:2]), point
    starts = [(first[2], point, first[:2])]
    relaxed = _relaxed_point(T, m)
    if relaxed is not None:
        frame = _best_frame(T, m, relaxed)
        starts.append((frame[2], relaxed, frame[:2]))
    _, start, at = min(starts, key=lambda candidate: candidate[0])
    return _refine(_PlacementProblem(T, m, start, at), point)


def place_target(T_base_link: ArrayLike, measured: ArrayLike, T_base_measurement: pin.SE3) -> FloatArray:
    """Find the measured point of a link from poses of that link, where the measurement frame is known.

    The mean over the poses of the point as each of them shows it, which is the least-squares solution.

    Args:
        T_base_link: Poses of the link that carries the point in the base link, (n, 4, 4) [m].
        measured: The point in the measurement frame, (n, 3) [m].
        T_base_measurement: Pose of the measurement frame in the base link.

    Returns:
        The point in its link, (3,) [m].

    Raises:
        DataError: Values that are not finite, or shapes that differ.
    """
    T, m = _checked_poses(T_base_link, measured)
    in_base = m @ T_base_measurement.rotation.T + T_base_measurement.translation
    point: FloatArray = np.einsum("nji,nj->ni", T[:, :3, :3], in_base - T[:, :3, 3]).mean(axis=0)
    return point


def _checked_poses(T_base_link: ArrayLike, measured: ArrayLike) -> tuple[FloatArray, FloatArray]:
    T, m = np.asarray(T_base_link, dtype=float), np.asarray(measured, dtype=float)
    if m.ndim != 2 or T.shape != (len(m), 4, 4) or m.shape != (len(m), 3) or len(m) == 0:
        raise DataError(
            f"link poses {T.shape} and measured points {m.shape} do not belong together; expected (n, 4, 4) and (n, 3)"
        )
    finite = np.isfinite(T).all(axis=(1, 2)) & np.isfinite(m).all(axis=1)
    if not finite.all():
        raise DataError(f"row {int(np.argmin(finite))}: a pose or a measured point is not finite; leave the row out")
    return T, m


def _best_frame(T: FloatArray, m: FloatArray, point: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Best X for a given point: R (3, 3), t (3,) [m] and the sum of squares [m^2]."""
    p, q = checked_points(m, T[:, :3, :3] @ point + T[:, :3, 3], None, [f"row {k}" for k in range(len(m))])
    rotation, translation = best_transform(p, q)
    return rotation, translation, float(np.sum((q - p @ rotation.T - translation) ** 2))


def _relaxed_point(T: FloatArray, m: FloatArray) -> FloatArray | None:
    """Point from R m + t - R_i p = t_i with R's entries free (linear); None where that has no single solution."""
    matrix = np.zeros((len(m), 3, 15))
    for row in range(3):
        matrix[:, row, 3 * row : 3 * row + 3] = m
        matrix[:, row, 9 + row] = 1.0
    matrix[:, :, 12:] = -T[:, :3, :3]
    solution, _, rank, _ = np.linalg.lstsq(matrix.reshape(-1, 15), T[:, :3, 3].ravel(), rcond=_RANK)
    return np.asarray(solution[12:]) if rank == 15 else None


@dataclass(frozen=True, eq=False)
class _PlacementProblem:
    """Rows R_X^T (R_i p + t_i - t_X) - m_i about a start (point, (R_X, t_X)).

    The nine unknowns are [dt_X; w; dp], with dt_X in the axes of the base link and R_X exp(w), so that the slope is
    [-R_X^T, [seen]x Jexp3(w), R_X^T R_i].
    """

    T: FloatArray
    m: FloatArray
    start: FloatArray
    frame: tuple[FloatArray, FloatArray]

    def unpack(self, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        rotation, translation = self.frame
        return rotation @ pin.exp3(x[3:6]), translation + x[:3], self.start + x[6:]

    def seen(self, x: FloatArray) -> FloatArray:
        rotation, translation, point = self.unpack(x)
        predicted: FloatArray = (self.T[:, :3, :3] @ point + self.T[:, :3, 3] - translation) @ rotation
        return predicted

    def rows(self, x: FloatArray) -> FloatArray:
        return (self.seen(x) - self.m).ravel()

    def slope(self, x: FloatArray) -> FloatArray:
        rotation = self.unpack(x)[0]
        result = np.empty((len(self.m), 3, 9))
        result[:, :, :3] = -rotation.T
        result[:, :, 3:6] = cross_matrices(self.seen(x)) @ pin.Jexp3(x[3:6])
        result[:, :, 6:] = rotation.T @ self.T[:, :3, :3]
        return result.reshape(-1, 9)


def _refine(problem: _PlacementProblem, guess: FloatArray) -> tuple[pin.SE3, FloatArray]:
    """Least squares over the measurement frame and the point together."""
    x = _least_squares(problem, np.zeros(9), np.eye(9))
    # lengths become angles over the extent of the points, so that one threshold judges both
    scale = np.ones(9)
    scale[3:6] = 1 / float(np.ptp(problem.m, axis=0).max())
    _, values, right = np.linalg.svd(np.linalg.qr(problem.slope(x) * scale, mode="r"))
    rank = int(np.sum(values > _RANK * values[0]))
    if rank < 9:  # of all equally good solutions, the one whose point is nearest to the guess
        free, held = (part.T * scale[:, None] for part in (right[rank:], right[:rank]))
        nearest_point = x + free @ np.linalg.lstsq(free[6:], guess - problem.start - x[6:], rcond=None)[0]
        x = _least_squares(problem, nearest_point, held)  # along `free` only rounding would decide
    rotation, translation, point = problem.unpack(x)
    return pin.SE3(rotation, translation), point


def _least_squares(problem: _PlacementProblem, x: FloatArray, moves: FloatArray) -> FloatArray:
    """Solve from x for steps along the columns of `moves`, (9, n)."""
    solution: FloatArray = least_squares(
        lambda steps: problem.rows(x + moves @ steps),
        np.zeros(moves.shape[1]),
        jac=lambda steps: problem.slope(x + moves @ steps) @ moves,
        x_scale="jac",
        xtol=1e-12,
        ftol=1e-12,
        gtol=1e-14,
    ).x
    return x + moves @ solution
