"""Splitting measurements into those to identify with and those to validate with, and into folds."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from calib.arrays import FloatArray, IntArray
from calib.data.measurements import Measurements
from calib.errors import DataError

_SAME_JOINTS = 1e-4  # joint values that agree to this are one pose, read back with an encoder's noise [m, rad]


def split(data: Measurements, fraction: float, seed: int = 0) -> tuple[Measurements, Measurements]:
    """Hold out a random part of the poses for validation; repeats of one pose stay together.

    Args:
        data: All measurements.
        fraction: Part of the poses to hold out, between 0 and 1.
        seed: Seed of the random choice.

    Returns:
        Measurements to identify with, and to validate with, both in file order.

    Raises:
        DataError: The fraction leaves one of them empty.
    """
    n_held = round(fraction * len(data)) if 0 < fraction < 1 else 0
    chosen: list[int] = []
    for group in _shuffled(data, seed):
        if len(chosen) >= n_held:
            break
        chosen.extend(int(k) for k in group)
    held: IntArray = np.array(chosen, dtype=np.intp)
    if not 0 < len(held) < len(data):
        raise DataError(
            f"{data.path}: holding out {fraction:g} of {len(data)} poses leaves nothing to"
            f" {'validate' if len(held) == 0 else 'identify'} with; give a fraction between 0 and 1, or a file"
        )
    return data.subset(np.setdiff1d(np.arange(len(data)), held)), data.subset(np.sort(held))


def deal(data: Measurements, count: int, seed: int = 0) -> list[IntArray]:
    """Deal the poses into folds of about equal size; repeats of one pose stay together.

    Returns:
        Indices of each fold, ascending, (n_in_fold,) each; empty where there are fewer different poses than folds.
    """
    folds: list[list[int]] = [[] for _ in range(max(count, 1))]
    for group in _shuffled(data, seed):
        min(folds, key=len).extend(int(k) for k in group)
    return [np.sort(np.array(fold, dtype=np.intp)) for fold in folds]


def pose_labels(joints: FloatArray) -> IntArray:
    """Return a number for each row of joint values (n, n_actuated); rows that repeat one pose have the same.

    Repeats agree to 0.1 mm and 0.1 mrad in every joint, or are linked by others that do.
    """
    cells, cell = np.unique(np.round(joints / _SAME_JOINTS), axis=0, return_inverse=True)
    linked = cKDTree(cells).query_pairs(1.5, p=np.inf, output_type="ndarray")  # the same cell or a neighbour
    graph = coo_array((np.ones(len(linked)), (linked[:, 0], linked[:, 1])), shape=(len(cells), len(cells)))
    label: IntArray = connected_components(graph, directed=False)[1][cell.reshape(-1)]
    return label


def _shuffled(data: Measurements, seed: int) -> list[IntArray]:
    """Return groups of visits that repeat one pose, in random order."""
    groups = _groups(data)
    return [groups[k] for k in np.random.default_rng(seed).permutation(len(groups))]


def _groups(data: Measurements) -> list[IntArray]:
    """Return groups of visits with the same pose name or the same joint values, in file order."""
    by_joints, by_name = pose_labels(data.joints), data.pose_numbers
    n = int(by_joints.max(initial=-1)) + 1
    size = n + data.n_poses
    graph = coo_array((np.ones(len(data)), (by_joints, n + by_name)), shape=(size, size))
    label: IntArray = connected_components(graph, directed=False)[1][by_joints]
    label = np.unique(label, return_inverse=True)[1].reshape(-1)
    by_label = np.argsort(label, kind="stable")
    groups = np.split(by_label, np.cumsum(np.bincount(label))[:-1])
    groups.sort(key=lambda group: int(group[0]))  # in file order, so that without repeats a pose is a pose
    return groups


def boxes(data: Measurements, count: int) -> list[IntArray]:
    """Cut joint space into boxes of about equally many poses, always across the joint that spreads widest.

    Args:
        data: All measurements.
        count: Number of boxes.

    Returns:
        Indices of each box, ascending, (n_in_box,) each; repeats of one pose stay together.
    """
    groups = _groups(data)
    centres = np.array([data.joints[group].mean(axis=0) for group in groups])
    spread = np.ptp(centres, axis=0)
    centres = centres / np.where(spread > 0, spread, 1.0)

    def cut(part: IntArray, into: int) -> list[IntArray]:
        if into == 1:
            return [part]
        # rounded, so that of joints that spread alike the first is cut on every processor
        joint = int(np.argmax(np.round(np.ptp(centres[part], axis=0), 6)))
        order = part[np.argsort(np.round(centres[part, joint], 9), kind="stable")]
        left = into // 2
        middle = len(order) * left // into
        return cut(order[:middle], left) + cut(order[middle:], into - left)

    found = cut(np.arange(len(groups)), count)
    return [np.sort(np.concatenate([groups[k] for k in part])) for part in found if len(part)]


def stretches(data: Measurements, count: int) -> list[IntArray]:
    """Cut the measurements into stretches of their order, of about equally many poses.

    Args:
        data: All measurements.
        count: Number of stretches.

    Returns:
        Indices of each stretch, ascending, (n_in_stretch,) each; repeats of one pose stay together.
    """
    groups = sorted(_groups(data), key=lambda group: int(data.places[group].min()))
    parts = np.array_split(np.arange(len(groups)), count)
    return [np.sort(np.concatenate([groups[k] for k in part])) for part in parts if len(part)]
