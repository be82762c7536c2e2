"""An order of poses with little travel of the robot.

The time between two poses is about that of the joint with the longest travel, so the distance between them is

    max over joints of |difference| / (range of that joint over all poses)

The shortest open path from home through all poses is a travelling-salesman problem. A path that always goes to the
nearest next pose is shortened by 2-opt (reverse a piece) and or-opt (move a piece of up to three poses), until neither
helps. The result is usually within a few percent of the shortest, which is enough, since the path does not change the
measurement. Poses are (n, n_actuated), and home is (n_actuated,) [m or rad].

Reference: croes1958; or1976.
"""

from __future__ import annotations

import numpy as np

from calib.core.base.arrays import FloatArray, IntArray

_SHORTER = 1e-12
_LONGEST_PIECE = 3
_IMPROVED = 1000  # largest number of poses for which the path is improved


def travel(joints: FloatArray, home: FloatArray) -> float:
    """Return the length of a path from home (n_actuated,) through poses (n, n_actuated) in turn [joint ranges]."""
    return float(np.sum(np.max(np.abs(np.diff(_points(joints, home), axis=0)), axis=1)))


def distances_from(joints: FloatArray, start: FloatArray) -> FloatArray:
    """Return the distances of poses (n, n_actuated) from joint values (n_actuated,), (n,) [joint ranges]."""
    points = _points(joints, start)
    return np.asarray(np.max(np.abs(points[1:] - points[0]), axis=1))


def order_in_blocks(joints: FloatArray, home: FloatArray, block: IntArray) -> IntArray:
    """Return a short order of poses (n, n_actuated) from home (n_actuated,) that goes block by block, (n,).

    Blocks (n,) ascend in the order of measurement. Between them something is changed by hand, such as an instrument.
    """
    order, start = [], home
    for number in np.unique(block):
        members = np.flatnonzero(block == number)
        order.append(members[shortest_order(joints[members], start)])
        start = joints[order[-1][-1]]
    return np.concatenate(order)


def shortest_order(joints: FloatArray, home: FloatArray) -> IntArray:
    """Return a short order of poses (n, n_actuated) from home (n_actuated,), (n,)."""
    points = _points(joints, home)
    gaps = np.max(np.abs(points[:, None] - points[None]), axis=2)
    path = _nearest_first(gaps)
    while len(joints) <= _IMPROVED:
        shorter = _reverse_piece(path, gaps)
        shorter = _move_piece(path, gaps) if shorter is None else shorter
        if shorter is None:
            break
        path = shorter
    return path[1:] - 1


def _points(joints: FloatArray, home: FloatArray) -> FloatArray:
    """Home and poses in joint ranges, (n + 1, n_actuated)."""
    width = np.ptp(joints, axis=0)
    return np.vstack([home, joints]) / np.where(width > 0, width, 1.0)


def _nearest_first(gaps: FloatArray) -> IntArray:
    path, left = [0], np.arange(1, len(gaps))
    while len(left):
        nearest = np.argmin(gaps[path[-1], left])
        path.append(int(left[nearest]))
        left = np.delete(left, nearest)
    return np.array(path, dtype=np.intp)


def _reverse_piece(path: IntArray, gaps: FloatArray) -> IntArray | None:
    """Reverse the piece that shortens the path most, or None; the end of the path is free."""
    n = len(path)
    step = gaps[path[:-1], path[1:]]
    # piece i+1 .. j: edges (i, i+1) and (j, j+1) become (i, j) and (i+1, j+1); j = n-1 has no second edge
    last = np.append(step, 0.0)
    closing = np.zeros((n - 1, n))
    closing[:, :-1] = gaps[np.ix_(path[1:], path[1:])]
    change = gaps[np.ix_(path[:-1], path)] + closing - step[:, None] - last
    change[np.tril_indices(n - 1, k=1, m=n)] = 0.0
    i, j = np.unravel_index(np.argmin(change), change.shape)
    if change[i, j] >= -_SHORTER:
        return None
    return np.concatenate([path[: i + 1], path[i + 1 : j + 1][::-1], path[j + 1 :]])


def _move_piece(path: IntArray, gaps: FloatArray) -> IntArray | None:
    """Move a piece of up to three poses, in either direction, if that shortens the path; else None."""
    for length in range(1, _LONGEST_PIECE + 1):
        for start in range(1, len(path) - length + 1):
            piece = path[start : start + length]
            rest = np.concatenate([path[:start], path[start + length :]])
            taken = gaps[path[start - 1], piece[0]]
            if start + length < len(path):
                after = path[start + length]
                taken += gaps[piece[-1], after] - gaps[path[start - 1], after]
            for turned in (piece, piece[::-1]):
                added = gaps[rest, turned[0]]
                added[:-1] += gaps[turned[-1], rest[1:]] - gaps[rest[:-1], rest[1:]]
                place = int(np.argmin(added))
                if added[place] < taken - _SHORTER:
                    return np.concatenate([rest[: place + 1], turned, rest[place + 1 :]])
    return None
