"""Rows that repeat one pose (one name, or joint values that agree), and poses that lie apart from others."""

from __future__ import annotations

import numpy as np
import scipy

from calib.core.base.arrays import BoolArray, FloatArray, IntArray
from calib.core.numerics.chances import UNLIKELY

APART = 0.05
"""Part of the poses that `is_apart` calls apart by chance, although all were drawn in the same way."""
SAME_JOINTS = 1e-4  # joint values that agree to this are one pose, read back with an encoder's noise [m, rad]


def pose_labels(joints: FloatArray) -> IntArray:
    """Return a number for each row of joint values (n, n_actuated); rows that repeat one pose have the same.

    Repeats agree to 0.1 mm and 0.1 mrad in every joint, or are linked by others that do.
    """
    rounded = np.round(joints / SAME_JOINTS)
    near = _may_have_neighbours(rounded)
    if not np.any(near):
        return np.arange(len(joints))
    cells, cell = np.unique(rounded[near], axis=0, return_inverse=True)
    linked = scipy.spatial.cKDTree(cells).query_pairs(
        1.5, p=np.inf, output_type="ndarray"
    )  # the same cell or a neighbour
    graph = scipy.sparse.coo_array((np.ones(len(linked)), (linked[:, 0], linked[:, 1])), shape=(len(cells), len(cells)))
    number, of_cell = scipy.sparse.csgraph.connected_components(graph, directed=False)
    result: IntArray = number + np.cumsum(~near) - 1
    result[near] = of_cell[cell.reshape(-1)]
    return result


def _may_have_neighbours(cells: FloatArray) -> BoolArray:
    """Return a mask of the rows of whole numbers (n, k) that may equal another row or differ from it by 1, (n,).

    If a and b differ by at most 1, floor(a / 2) = floor(b / 2) or floor((a + 1) / 2) = floor((b + 1) / 2). So rows that
    are near each other are in one cell of at least one of four grids, of the two columns that reach farthest.
    """
    near = np.zeros(len(cells), dtype=bool)
    if len(cells) == 0:
        return near
    reach = np.ptp(cells, axis=0)
    first, second = (cells[:, k] - cells[:, k].min() for k in np.argsort(-reach)[[0, min(1, len(reach) - 1)]])
    width = float(np.max(reach)) + 2.0
    for shifts in ((0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0)):
        place = np.floor((first + shifts[0]) / 2.0) * width + np.floor((second + shifts[1]) / 2.0)
        order = np.argsort(place)
        same = place[order[1:]] == place[order[:-1]]
        near[order[1:][same]] = near[order[:-1][same]] = True
    return near


def repeated_poses(joints: FloatArray, by_name: IntArray) -> list[IntArray]:
    """Return groups of rows that repeat one pose, by its name or by its joint values, in the order of the rows.

    Joint values are (n, n_actuated) [m or rad]; `by_name` is a number for each row, equal for equal names, (n,).
    """
    order, starts = _rows_by_pose(joints, by_name)
    return np.split(order, starts[1:])


def _rows_by_pose(joints: FloatArray, by_name: IntArray) -> tuple[IntArray, IntArray]:
    """The rows of each group of `repeated_poses`, one group after the other, (n,), and where each begins, (n_groups,).

    A pose without repeats is a group of one row.
    """
    by_joints, label = pose_labels(joints), by_name
    n = int(by_joints.max(initial=-1)) + 1
    if n < len(joints):  # some poses agree in their joint values
        size = n + int(by_name.max(initial=-1)) + 1
        graph = scipy.sparse.coo_array((np.ones(len(joints)), (by_joints, n + by_name)), shape=(size, size))
        label = scipy.sparse.csgraph.connected_components(graph, directed=False)[1][by_joints]
    _, first, number = np.unique(label, return_index=True, return_inverse=True)
    order = np.argsort(first[number.reshape(-1)], kind="stable")
    sizes = np.bincount(number.reshape(-1))[np.argsort(first)]
    return order, np.cumsum(sizes) - sizes


def shuffled_poses(joints: FloatArray, by_name: IntArray, seed: int) -> list[IntArray]:
    """Return the groups of `repeated_poses` of joints (n, n_actuated) and numbers `by_name` (n,), in random order."""
    groups = repeated_poses(joints, by_name)
    return [groups[k] for k in np.random.default_rng(seed).permutation(len(groups))]


def is_apart(joints: FloatArray, used: FloatArray) -> BoolArray:
    """Return a mask of the poses (n, n_actuated) that lie apart from the poses used (n_used, n_actuated) [m or rad],
    (n,).

    Such a pose is farther from its nearest used pose than 95 in 100 used poses are from their nearest neighbours.
    Distances are in joint space, in units of each joint's standard deviation over the poses used; repeats of a pose
    count once. Of poses drawn like those used, about one in 20 lies apart. With fewer than 19 poses used, none does.
    """
    first = np.unique(pose_labels(used), return_index=True)[1]
    unit = np.maximum(np.std(used, axis=0), SAME_JOINTS)
    k = int(np.ceil((1.0 - APART) * (len(first) + 1) - 1e-9))
    if k > len(first):
        return np.zeros(len(joints), dtype=bool)
    near = scipy.spatial.cKDTree(used[first] / unit)
    limit = np.sort(near.query(used[first] / unit, k=2)[0][:, 1])[k - 1]
    return np.asarray(near.query(joints / unit)[0] > limit)


def are_drawn_alike(joints: FloatArray, used: FloatArray) -> bool:
    """Return whether poses (m, n_actuated) lie among those used (n, n_actuated) as if both were drawn together.

    If m poses and n used poses are drawn alike, the nearest neighbour of one of the m is another of the m with a chance
    of (m - 1) / (m + n - 1). If this holds for more poses than chance explains, the poses are somewhere else, or crowd
    together. Distances are those of `is_apart`. Poses that were used count as drawn alike. Reference: schilling1986.
    """
    new, old = (poses[np.unique(pose_labels(poses), return_index=True)[1]] for poses in (joints, used))
    if len(new) < 2 or len(old) == 0:
        return True
    unit = np.maximum(np.std(used, axis=0), SAME_JOINTS)
    to_old = scipy.spatial.cKDTree(old / unit).query(new / unit)[0]
    to_new = scipy.spatial.cKDTree(new / unit).query(new / unit, k=2)[0][:, 1]
    crowded = int(np.sum(to_new < to_old))
    by_chance = (len(new) - 1) / (len(new) + len(old) - 1)
    return crowded == 0 or bool(scipy.special.bdtrc(crowded - 1, len(new), by_chance) >= UNLIKELY)


def boxes(joints: FloatArray, by_name: IntArray, count: int, depths: IntArray) -> IntArray:
    """Cut joint space into boxes of about equally many poses, always across the joint that spreads widest.

    The result depends neither on the order of the joints nor on the direction of their axes. If joints spread alike,
    the one nearest to the base is cut; if several are as near, the one whose values differ first, pose by pose. If
    the poses cannot be halved, the side to which a joint's values lean has one more.

    The result is the number of the box of each row, (n,), the same for repeats of one pose (`repeated_poses`).
    There are `count` boxes, but no more than different poses. `depths` says how far each joint is from the base,
    (n_actuated,).
    """
    order, starts = _rows_by_pose(joints, by_name)
    sizes = np.diff(starts, append=len(order))
    centres = _both_ways_alike(np.add.reduceat(joints[order], starts) / sizes[:, None])
    sizes_in_order = np.abs(centres.T).astype(">f8")  # the bytes of such numbers are sorted as the numbers are
    by_base = sorted(range(len(depths)), key=lambda joint: (depths[joint], sizes_in_order[joint].tobytes()))
    centres = centres[:, by_base]

    def cut(part: IntArray, into: int) -> list[IntArray]:
        if into == 1:
            return [part]
        # rounded: if joints spread alike, every processor cuts the first of them
        joint = int(np.argmax(np.round(np.ptp(centres[part], axis=0), 6)))
        arranged = part[np.argsort(centres[part, joint], kind="stable")]
        left = into // 2
        middle = len(arranged) * left // into
        return cut(arranged[:middle], left) + cut(arranged[middle:], into - left)

    box = np.empty(len(starts), dtype=np.intp)
    parts = cut(np.arange(len(starts)), min(count, len(starts)))
    for number, part in enumerate(parts):
        box[part] = number
    of_row = np.empty(len(order), dtype=np.intp)
    of_row[order] = np.repeat(box, sizes)
    return of_row


def _both_ways_alike(centres: FloatArray) -> FloatArray:
    """Return joint values (n, k) from the middle of their range, in units of it, with the sign of each joint chosen.

    So the result does not change if an axis is reversed: the mean is positive, or if it is 0, the first value.
    """
    low, high = np.min(centres, axis=0), np.max(centres, axis=0)
    spread = np.where(high > low, high - low, 1.0)
    values = np.round((centres - (low + high) / 2) / spread, 9)
    lean = np.round(np.mean(values, axis=0), 9)
    first = values[np.argmax(values != 0.0, axis=0), np.arange(values.shape[1])]
    return values * np.where(np.where(lean != 0.0, lean, first) < 0.0, -1.0, 1.0)
