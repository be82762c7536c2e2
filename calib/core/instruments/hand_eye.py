"""The hand-eye problem: first values, in closed form, of two unknown frames on two links.

Frame a is fixed to one link by C, and frame b to another link by M. The robot gives the pose L_i of the second link in
the first one. An instrument sees frame b from frame a as

    A_i = C^-1 L_i M          or          C A_i = L_i M

The rotations that make sum |C A_i - L_i M|^2 smallest maximise a form that is bilinear in C and M. The first pair of
its singular vectors, made rotations, starts an alternation: each rotation follows from the other in closed form
(Wahba's problem). Then the translations are a linear problem. Where one of C and M is known, the other follows in one
step.

If all L_i turn about one axis (SCARA), the rotations fit alike however C is turned about it; if none turns (delta),
however C is turned. With L the mean of the L_i and h = 1 - L L^T, a turn of C by a small vector d makes the sum of
squared angles larger by n d^T h d. Where h has an eigenvalue near 0, rotations and positions determine C together. Of
the positions p_i of A_i and q_i of L_i, let P take away what shifts of C and M explain. As long as P and the turn
commute, |P (C p_i - q_i)|^2 is least where the trace of C^T B is largest, B being the sum of (P q)_i p_i^T. This is
Wahba's problem again, to which h adds the rotations. Gauss-Newton steps follow, since axes may be parallel only nearly.

When it fails. If the poses turn about parallel axes only, C and M may move along these together. If positions do not
show the turn either, C turns as little as possible from where it is now.

References: wahba1965, daniilidis1999.
"""

from __future__ import annotations

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.instruments.rotations import rotation_vectors
from calib.core.numerics import linalg
from calib.core.numerics.rigid import cross_matrices, nearest_rotation, rotations_by

LEVER = 0.3
"""Length of the lever by which a rotation counts as a distance [m]."""
_ROUNDS = 50
_SETTLED = 1e-9
_PARALLEL = 0.1  # directions count as parallel that lean less from a common one (RMS) [rad]
_FIRST = 1e6  # weight of rotations against positions before the Gauss-Newton steps
_NEAR = 1e-10  # weight of the present C against both
_UNSEEN = 1e-9  # singular values below this part of the largest count as 0


def solve_rotations(
    links: FloatArray, seen: FloatArray, first: FloatArray | None = None, second: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return the rotations (C, M) for which C A_i = L_i M fits best, (..., 3, 3) each; of L_i and A_i, (..., n, 3, 3).

    `first` and `second` are C and M, where they are known.
    """
    form = rotation_form(links, seen)
    if first is not None:
        return first, _best_rotation(np.swapaxes(form, -1, -2), first) if second is None else second
    if second is not None:
        return _best_rotation(form, second), second
    form = form[..., None, :, :]  # both signs of the singular vectors are tried
    lines = linalg.svd(form)[2][..., 0, :].reshape(*form.shape[:-2], 3, 3)
    second = nearest_rotation(lines * np.array([1.0, -1.0])[:, None, None])
    first, moving = second, np.ones(second.shape[:-2], dtype=bool)
    for _ in range(_ROUNDS):
        next_first = _best_rotation(form, second)
        next_second = _best_rotation(np.swapaxes(form, -1, -2), next_first)
        settled = np.max(np.abs(next_second - second), axis=(-2, -1)) < _SETTLED
        chosen = moving[..., None, None]
        first, second = np.where(chosen, next_first, first), np.where(chosen, next_second, second)
        moving = moving & ~settled
        if not np.any(moving):
            break
    agrees = np.sum(_times(form, second) * first, axis=(-2, -1))
    better = (agrees[..., 1] > agrees[..., 0])[..., None, None]
    return np.where(better, first[..., 1, :, :], first[..., 0, :, :]), np.where(
        better, second[..., 1, :, :], second[..., 0, :, :]
    )


def rotation_form(links: FloatArray, seen: FloatArray) -> FloatArray:
    """Return the bilinear form of C and M, (..., 9, 9), of L_i and A_i, (..., n, 3, 3)."""
    return np.einsum("...kad,...kbc->...abdc", links, seen).reshape(*links.shape[:-3], 9, 9)


def _times(form: FloatArray, rotation: FloatArray) -> FloatArray:
    """The bilinear form, (..., 9, 9), with one of its two rotations, (..., 3, 3): a matrix, (..., 3, 3)."""
    return (form @ rotation.reshape(*rotation.shape[:-2], 9, 1)).reshape(*rotation.shape[:-2], 3, 3)


def _best_rotation(form: FloatArray, rotation: FloatArray) -> FloatArray:
    """The rotation that maximises the form if the other rotation is given, (..., 3, 3)."""
    return nearest_rotation(_times(form, rotation))


def solve_poses(
    links: FloatArray,
    seen: FloatArray,
    now: tuple[FloatArray, FloatArray],
    known: tuple[bool, bool],
    unseen: float = _UNSEEN,
) -> tuple[FloatArray, FloatArray]:
    """Return the poses (C, M) for which C A_i = L_i M fits best, (..., 4, 4) each [m].

    Args:
        links, seen: L_i and A_i, (..., n, 4, 4) [m].
        now: Present C and M, (4, 4) each [m]; components that the data do not determine stay near them.
        known: Whether C is known, and whether M is.
        unseen: Shifts with singular values below this part of the largest stay as they are.
    """
    first, second = (np.tile(pose, (*links.shape[:-3], 1, 1)) for pose in now)
    first[..., :3, :3], second[..., :3, :3] = solve_rotations(
        links[..., :3, :3],
        seen[..., :3, :3],
        first[..., :3, :3] if known[0] else None,
        second[..., :3, :3] if known[1] else None,
    )
    together = (linalg.eigvalsh(_turning(links[..., :3, :3]))[..., 0] < _PARALLEL**2) & (not any(known))
    free = np.repeat(np.logical_not(known), 3)
    for k in np.ndindex(links.shape[:-3]):
        if together[k]:
            first[k][:3, :3], second[k][:3, :3] = _with_positions(links[k], seen[k], first[k], now[0])
        columns = _shifts(links[k])
        moved = np.concatenate([first[k][:3, 3], second[k][:3, 3]])
        right_side = (links[k][:, :3, 3] - seen[k][:, :3, 3] @ first[k][:3, :3].T).reshape(-1) - columns @ moved
        moved[free] += linalg.lstsq(columns[:, free], right_side, rcond=unseen)
        first[k][:3, 3], second[k][:3, 3] = moved[:3], moved[3:]
    return first, second


def _turning(links: FloatArray) -> FloatArray:
    """How well rotations L_i, (..., n, 3, 3), determine turns of C: h of the module docstring, (..., 3, 3)."""
    mean = np.mean(links, axis=-3)
    return np.eye(3) - mean @ np.swapaxes(mean, -1, -2)


def _shifts(links: FloatArray) -> FloatArray:
    """Derivative of C A_i - L_i M by shifts of C and M, and of its turn by theirs, (3 n, 6); of L_i, (n, 4, 4)."""
    return np.concatenate([np.tile(np.eye(3), (len(links), 1, 1)), -links[:, :3, :3]], axis=2).reshape(-1, 6)


def _with_positions(
    links: FloatArray, seen: FloatArray, first: FloatArray, now: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Rotations (C, M) that fit rotations and positions together, (3, 3) each.

    Args:
        links, seen: L_i and A_i, (n, 4, 4) [m].
        first: C that fits rotations best, (4, 4).
        now: Present C, (4, 4).
    """
    n, L, A, q, p = 3 * len(links), links[:, :3, :3], seen[:, :3, :3], links[:, :3, 3], seen[:, :3, 3]
    C, h, columns, weight = first[:3, :3], _turning(L), _shifts(links), LEVER**2 * len(links)
    shifts = linalg.orth(columns, _PARALLEL)  # without those along the axes: P and turns about these commute
    B = (q.reshape(-1) - shifts @ (shifts.T @ q.reshape(-1))).reshape(-1, 3).T @ p + _NEAR * weight * now[:3, :3]
    C = nearest_rotation(B @ C.T + _FIRST * weight * (np.trace(h) / 2.0 * np.eye(3) - h)) @ C
    M = _best_rotation(rotation_form(L, A).T, C)
    shifts = linalg.orth(columns, _UNSEEN)
    best: FloatArray = np.stack([C, M])
    step: FloatArray = np.zeros(6)
    least = np.inf
    for _ in range(_ROUNDS):
        points, turned = p @ C.T, rotation_vectors(C @ A @ M.T @ L.swapaxes(1, 2))
        errors, J = np.append(points - q, LEVER * turned), np.vstack([np.zeros((n, 6)), LEVER * columns])
        J[:n, :3] = -cross_matrices(points).reshape(n, 3)
        errors[:n] -= shifts @ (shifts.T @ errors[:n])
        J[:n] -= shifts @ (shifts.T @ J[:n])
        step = step / 4.0  # if the last one did not lower the sum of squares
        if errors @ errors < least:
            best, least, step = np.stack([C, M]), float(errors @ errors), -linalg.lstsq(J, errors, rcond=_UNSEEN)
        if np.max(np.abs(step)) < _SETTLED:
            break
        C, M = rotations_by(step.reshape(2, 3)) @ best
    return best[0], best[1]
