"""Where both ends of what is looked along are fixed: closed forms for first guesses.

Frame a is fixed to one link by C, frame b to another one by M, and the robot says how the links lie, L_i. Seen is

    A_i = C^-1 L_i M          or          C A_i = L_i M

known as the hand-eye problem. The rotations that make sum |C A_i - L_i M|^2 smallest maximise a form that is bilinear
in C and M; its largest singular vectors, made rotations, are the start of an alternation in which each of the two
follows from the other in closed form (Wahba's problem). The translations then are a linear problem. Where one of the
two is known, the other follows in one step.

When it fails. Poses that all turn about parallel axes leave a part open; what comes out is then one of many answers.

References: wahba1965, daniilidis1999.
"""

from __future__ import annotations

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.numerics import linalg
from calib.core.numerics.rigid import nearest_rotation

_ROUNDS = 50
_SETTLED = 1e-9


def fixed_rotations(
    links: FloatArray, seen: FloatArray, first: FloatArray | None = None, second: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return the rotations (C, M) for which C A_i = L_i M fits best, (3, 3) each.

    Args:
        links: L_i, (n, 3, 3).
        seen: A_i, (n, 3, 3).
        first: C, where it is known.
        second: M, where it is known.
    """
    if first is not None:
        return first, nearest_rotation(np.einsum("kba,bc,kcd->ad", links, first, seen)) if second is None else second
    if second is not None:
        return _first_of(links, seen, second), second
    form = np.einsum("kad,kbc->abdc", links, seen).reshape(9, 9)
    u, _, vt = linalg.svd(form)
    candidates = [(sign * u[:, 0].reshape(3, 3), sign * vt[0].reshape(3, 3)) for sign in (1.0, -1.0)]
    best: tuple[float, FloatArray, FloatArray] | None = None
    for _, start in candidates:
        fitted_second = nearest_rotation(start)
        for _ in range(_ROUNDS):
            fitted_first, last = _first_of(links, seen, fitted_second), fitted_second
            fitted_second = nearest_rotation(np.einsum("kba,bc,kcd->ad", links, fitted_first, seen))
            if np.max(np.abs(fitted_second - last)) < _SETTLED:
                break
        agrees = float(np.einsum("ab,kbc,dc,kad->", fitted_first, seen, fitted_second, links))
        if best is None or agrees > best[0]:
            best = agrees, fitted_first, fitted_second
    assert best is not None
    return best[1], best[2]


def _first_of(links: FloatArray, seen: FloatArray, second: FloatArray) -> FloatArray:
    return nearest_rotation(np.einsum("kab,bc,kdc->ad", links, second, seen))


def fixed_poses(
    links: FloatArray, seen: FloatArray, now: tuple[FloatArray, FloatArray], known: tuple[bool, bool]
) -> tuple[FloatArray, FloatArray]:
    """Return the poses (C, M) for which C A_i = L_i M fits best, (4, 4) each [m].

    Args:
        links: L_i, (n, 4, 4) [m].
        seen: A_i, (n, 4, 4) [m].
        now: C and M as they are; what the data leave open stays near.
        known: Which of them are known.
    """
    first, second = now[0].copy(), now[1].copy()
    first[:3, :3], second[:3, :3] = fixed_rotations(
        links[:, :3, :3],
        seen[:, :3, :3],
        first[:3, :3] if known[0] else None,
        second[:3, :3] if known[1] else None,
    )
    n = len(links)
    columns = np.concatenate([np.tile(np.eye(3), (n, 1, 1)), -links[:, :3, :3]], axis=2).reshape(3 * n, 6)
    moved = np.concatenate([first[:3, 3], second[:3, 3]])
    right_side = (links[:, :3, 3] - seen[:, :3, 3] @ first[:3, :3].T).reshape(-1) - columns @ moved
    free = np.repeat(np.logical_not(known), 3)
    moved[free] += linalg.lstsq(columns[:, free], right_side, rcond=1e-9)
    first[:3, 3], second[:3, 3] = moved[:3], moved[3:]
    return first, second
