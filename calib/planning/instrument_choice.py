"""Choosing instruments too: a candidate is a pose together with a group of instruments that read there.

A group is possible at every pose where all of its instruments have something to read. Each pair of pose and group can
be chosen once, so two groups may read one pose; their information adds up, as for any two candidates. Candidates are
ordered by group, then by pose: candidate k has pose k modulo the number of poses.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, IntArray
from calib.core.base.errors import InputError, require_known
from calib.core.base.memory import zeros_with_room
from calib.core.data.measurements import Measurements, Poses
from calib.core.data.plan_files import TOGETHER
from calib.core.robots.robot import Robot
from calib.core.rows.observed import touches_without_target
from calib.shared.candidates import PoseRows, near_measured

ALL, EACH = "all", "each"
"""`ALL`: all instruments read at every chosen pose. `EACH`: each instrument is a group of its own."""


@dataclass(frozen=True)
class Groups:
    """Groups of instruments to choose among at a pose.

    Attributes:
        members: Names of the instruments in each group, which read together.
        chosen: Whether to choose among groups; False: only poses are chosen, and all instruments read there.
        counts: Number of poses for each group; None: the best numbers.
    """

    members: tuple[tuple[str, ...], ...]
    chosen: bool
    counts: tuple[int, ...] | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each group."""
        return tuple(TOGETHER.join(members) for members in self.members)


def groups_of(robot: Robot, instruments: str | Sequence[str], count: int | Mapping[str, int]) -> Groups:
    """Return the groups of instruments to choose among; see `calib.planning.selection.select` for the arguments."""
    names = tuple(instrument.name for instrument in robot.instruments)
    if isinstance(count, Mapping):
        if instruments != ALL:
            raise InputError("count gives a number for each instrument already; leave out `instruments`")
        return Groups(_members(tuple(count), names), True, tuple(count.values()))
    if instruments == ALL:
        return Groups((names,), False)
    if instruments == EACH:
        return Groups(tuple((name,) for name in names), True)
    named = [instruments] if isinstance(instruments, str) else list(instruments)
    return Groups(_members(named, names), True)


def _members(named: Sequence[str], names: Sequence[str]) -> tuple[tuple[str, ...], ...]:
    groups = tuple(tuple(name.strip() for name in group.split(TOGETHER)) for group in named)
    for group in groups:
        for name in group:
            require_known(name, names, "instruments: no instrument")
        if len(set(group)) < len(group):
            raise InputError(f"instruments: '{TOGETHER.join(group)}' names an instrument twice")
    if not groups or len({frozenset(group) for group in groups}) < len(groups):
        raise InputError("instruments: name each instrument, or each group of them, once")
    return groups


@dataclass(frozen=True, eq=False)
class PoseGroupPairs:
    """Candidates: pairs of a pose and a group of instruments; see the module docstring.

    Attributes:
        pose, group: Pose and group of each, (n_candidates,).
        rows: Whitened rows, padded with 0, (n_candidates, n_rows, n_parameters).
        n_read: Number of rows of each, (n_candidates,).
        possible: Whether all instruments of the group have something to read, (n_candidates,).
    """

    pose: IntArray
    group: IntArray
    rows: FloatArray
    n_read: IntArray
    possible: BoolArray


def pairs_of(groups: Groups, poses: PoseRows) -> PoseGroupPairs:
    """Return the candidates: all pairs of the n poses and the groups."""
    n, n_groups = len(poses.rows), len(groups.members)
    columns_of_groups = [np.r_[tuple(poses.blocks[name] for name in members)] for members in groups.members]
    width = max(len(columns) for columns in columns_of_groups)
    rows = poses.rows
    if groups.chosen:
        rows = zeros_with_room((n_groups * n, width, poses.rows.shape[2]), f"rows of {n_groups * n} candidates")
        for g, columns in enumerate(columns_of_groups):
            rows[g * n : (g + 1) * n, : len(columns)] = poses.rows[:, columns]
    read = [[np.any(poses.read[:, poses.blocks[name]], axis=1) for name in members] for members in groups.members]
    together = np.all if groups.chosen else np.any
    return PoseGroupPairs(
        np.tile(np.arange(n), n_groups),
        np.repeat(np.arange(n_groups), n) if n_groups > 1 else np.broadcast_to(np.intp(0), n),
        rows,
        np.concatenate([np.sum(poses.read[:, columns], axis=1) for columns in columns_of_groups]),
        np.concatenate([together(parts, axis=0) for parts in read]),
    )


def already_read(groups: Groups, candidates: Poses, measured: Poses) -> BoolArray:
    """Return the mask of candidates that all instruments of their group have already measured, (n_candidates,).

    Measured poses without readings count as read by all instruments.
    """
    result = []
    for members in groups.members:
        read = np.ones(len(measured), dtype=bool)
        if groups.chosen and isinstance(measured, Measurements):
            for name in members:
                readings = measured.readings.get(name)
                read &= np.isin(np.arange(len(measured)), [] if readings is None else readings.visits)
        none = np.zeros(len(candidates), dtype=bool)
        result.append(near_measured(candidates.joints, measured.joints[read]) if np.any(read) else none)
    return np.concatenate(result)


def require_planned_touches(robot: Robot, groups: Groups, poses: Poses) -> None:
    """Raise `InputError` if an instrument of a group touches, and the poses do not name the touched target."""
    for instrument in touches_without_target(robot, poses):
        if any(instrument.name in members for members in groups.members):
            raise InputError(
                f"{poses.path}: instrument '{instrument.name}' reads no numbers, and the poses do not say what it"
                f" touches; add a column '{instrument.text_columns()[0]}' that names it, empty where nothing is touched"
            )
