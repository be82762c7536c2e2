"""The hand-eye problem: first values, in closed form, of two unknown frames on two links.

Frame a is fixed to one link by C, and frame b to another link by M. The robot gives the pose L_i of the second link in
the first one. An instrument sees frame b from frame a as

    A_i = C^-1 L_i M          or          C A_i = L_i M

The rotations that make sum |C A_i - L_i M|^2 smallest maximise a form that is bilinear in C and M. The first pair of
its singular vectors, made rotations, starts an alternation: each rotation follows from the other in closed form
(Wahba's problem). Then the translations are a linear problem. Where one of C and M is known, the other follows in one
step.

When it fails. If the poses turn about parallel axes only, the solution is not unique; the result is one of many.

References: wahba1965, daniilidis1999.
"""

from __future__ import annotations

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.numerics import linalg
from calib.core.numerics.rigid import nearest_rotation

_ROUNDS = 50
_SETTLED = 1e-9


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
    links: FloatArray, seen: FloatArray, now: tuple[FloatArray, FloatArray], known: tuple[bool, bool]
) -> tuple[FloatArray, FloatArray]:
    """Return the poses (C, M) for which C A_i = L_i M fits best, (..., 4, 4) each [m].

    Args:
        links, seen: L_i and A_i, (..., n, 4, 4) [m].
        now: Present C and M, (4, 4) each [m]; components that the data do not determine stay near them.
        known: Whether C is known, and whether M is.
    """
    first, second = (np.tile(pose, (*links.shape[:-3], 1, 1)) for pose in now)
    first[..., :3, :3], second[..., :3, :3] = solve_rotations(
        links[..., :3, :3],
        seen[..., :3, :3],
        first[..., :3, :3] if known[0] else None,
        second[..., :3, :3] if known[1] else None,
    )
    n = links.shape[-3]
    free = np.repeat(np.logical_not(known), 3)
    for k in np.ndindex(links.shape[:-3]):
        columns = np.concatenate([np.tile(np.eye(3), (n, 1, 1)), -links[k][:, :3, :3]], axis=2).reshape(3 * n, 6)
        moved = np.concatenate([first[k][:3, 3], second[k][:3, 3]])
        right_side = (links[k][:, :3, 3] - seen[k][:, :3, 3] @ first[k][:3, :3].T).reshape(-1) - columns @ moved
        moved[free] += linalg.lstsq(columns[:, free], right_side, rcond=1e-9)
        first[k][:3, 3], second[k][:3, 3] = moved[:3], moved[3:]
    return first, second
