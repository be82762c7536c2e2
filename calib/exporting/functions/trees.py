"""A mechanism as the few facts that its kinematics need: joints in order, frames on them, and loop closures.

Fixed joints are folded. Each remaining joint turns about, or slides along, the z axis of its own frame, which has a
constant pose seen from the joint that carries it. So code needs one constant transform and one elementary motion for
each joint.

Values of the joints are x = [driven joints; passive joints]; joint k has the value factor_k x_c(k) + offset_k, which
covers `<mimic>` too. "World" is the nearest frame that carries all frames of interest, so that a robot far from the
root link's origin loses no digits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays
from calib.core.robots.closure import AssemblyMode
from calib.core.robots.continuation import closing_tolerance
from calib.core.robots.loops import LIMIT_MARGIN
from calib.core.robots.mechanism import Mechanism

_LARGEST_TURN = 2 * np.pi


class TreeJoint(NamedTuple):
    """A moving joint.

    Attributes:
        before: Number of the joint that carries it, from 1; 0 is the world.
        slides: Whether it slides along z; else it turns about z.
        coordinate: Index in x of its coordinate.
        factor, offset: Its value is factor x + offset [m or rad].
        placement: Pose of its frame seen from the moved frame of the joint that carries it, (4, 4) [m].
    """

    before: int
    slides: bool
    coordinate: int
    factor: float
    offset: float
    placement: FloatArray


class TreeFrame(NamedTuple):
    """A frame on a joint.

    Attributes:
        after: Number of the joint; 0 is the world.
        placement: Pose seen from the moved frame of the joint, (4, 4) [m].
        moved_by: 1 for each joint that moves it, else 0, (n_joints,).
    """

    after: int
    placement: FloatArray
    moved_by: IntArray


@dataclass(frozen=True, eq=False)
class FunctionTree(ReadOnlyArrays):
    """Joints and frames from which kinematics are written.

    Attributes:
        joints: The joints, each after the joint that carries it.
        frames: Frames of interest.
        closures: For each loop: a and b, indices among the frames, and the components (of x, y, z) of frame b in frame
            a that must be zero; loops that constrain whole poses are refused (`calib.exporting.file_formats`).
        n_driven, n_passive: Sizes of the two parts of x.
        scale: Scale of each element of x: 1 rad, or a length, (n_driven + n_passive,).
        starts: Closed configurations, home first, (n_starts, n_driven + n_passive).
        blocks: Rows and columns of each block of C_p, the derivative of the closures by the passive joints, whose
            determinant decides the assembly mode.
        signs: Sign of each of these determinants, (n_blocks,).
        limits: For each passive joint with limits: its index among them, whether it turns, lower and upper limit
            [m or rad].
        tolerance: Largest residual of a closed pose [m, rad].
    """

    joints: tuple[TreeJoint, ...]
    frames: tuple[TreeFrame, ...]
    closures: tuple[tuple[int, int, tuple[int, ...]], ...]
    n_driven: int
    n_passive: int
    scale: FloatArray
    starts: FloatArray
    blocks: tuple[tuple[tuple[int, ...], tuple[int, ...]], ...]
    signs: FloatArray
    limits: tuple[tuple[int, bool, float, float], ...]
    tolerance: float

    @property
    def follows(self) -> FloatArray:
        """Derivative of each joint's value by x, (n_joints, n_driven + n_passive)."""
        result = np.zeros((len(self.joints), self.n_driven + self.n_passive))
        for row, joint in zip(result, self.joints, strict=True):
            row[joint.coordinate] = joint.factor
        return result

    @property
    def behind(self) -> BoolArray:
        """Mask of the joints behind each joint, including itself, (n_joints, n_joints)."""
        result = np.eye(len(self.joints), dtype=bool)
        for k, joint in enumerate(self.joints):
            if joint.before:
                result[:, k] |= result[:, joint.before - 1]
        return result


def tree_of(
    mechanism: Mechanism, mode: AssemblyMode, frames: Sequence[int], starts: FloatArray, *, from_root: bool = False
) -> FunctionTree:
    """Return the facts of a mechanism.

    The joints `frames` are the frames of interest, which come before those of the loops; `starts` are closed
    configurations, home first, (n_starts, n_driven + n_passive) [m or rad].
    """
    ends = [index for loop in mechanism.loops for index in (loop.a, loop.b)]
    indices = [*frames, *ends]
    select = np.hstack([mechanism.select_actuated, mechanism.select_passive])
    shared = np.logical_and.reduce([mechanism.support[index] > 0 for index in indices])
    shared &= not from_root
    needed = np.logical_or.reduce([mechanism.support[index] > 0 for index in indices]) & ~shared
    joints, at = _fold_frames(mechanism, select, shared, needed)
    of_joints = [index - 1 for index in range(1, len(at)) if at[index].own]
    passive_scale = np.where(mechanism.is_metre_column, mechanism.length, 1.0)
    n = len(frames)
    return FunctionTree(
        joints=joints,
        frames=tuple(
            TreeFrame(at[index].after, at[index].place.homogeneous, 1 * (mechanism.support[index][of_joints] > 0))
            for index in indices
        ),
        closures=tuple((n + 2 * k, n + 2 * k + 1, loop.rows) for k, loop in enumerate(mechanism.loops)),
        n_driven=len(mechanism.driven),
        n_passive=len(mechanism.passive),
        scale=np.concatenate([mechanism.driven_scale, passive_scale]),
        starts=starts,
        blocks=tuple(
            (tuple(rows.tolist()), tuple(columns.tolist()))
            for rows, columns in zip(mode.block_rows, mode.block_columns, strict=True)
        ),
        signs=mode.signs if mechanism.loops else np.zeros(0),
        limits=tuple(_limits(mechanism)),
        tolerance=closing_tolerance(mechanism) / 10,
    )


class _FramePlace(NamedTuple):
    """Place of a frame: number of a joint, constant pose behind that joint, and whether it is the joint's own frame."""

    after: int
    place: pin.SE3
    own: bool = False


def _fold_frames(
    mechanism: Mechanism, select: FloatArray, shared: BoolArray, needed: BoolArray
) -> tuple[tuple[TreeJoint, ...], list[_FramePlace]]:
    """Return the moving joints, and the place of each frame of the mechanism."""
    identity = pin.SE3.Identity()
    at, joints = [_FramePlace(0, identity)], list[TreeJoint]()
    for k in range(mechanism.n_joints):
        if shared[k]:  # it carries all frames of interest
            at.append(_FramePlace(0, identity))
            continue
        before = at[mechanism.model.parents[k + 1]]
        place = before.place * mechanism.model.jointPlacements[k + 1]
        follows = np.flatnonzero(select[k])
        if len(follows) == 0 or not needed[k]:
            at.append(
                _FramePlace(before.after, place * pin.exp6(pin.Motion(mechanism.axes[k] * mechanism.constant[k])))
            )
            continue
        linear, angular = mechanism.axes[k, :3], mechanism.axes[k, 3:]
        slides = not np.any(angular)
        axis = linear if slides else angular
        length = float(np.linalg.norm(axis))
        aligned = pin.SE3(_to_z(axis / length), np.zeros(3))
        factor = float(select[k, follows[0]]) * length
        offset = float(mechanism.constant[k]) * length
        placement = (place * aligned).homogeneous
        joints.append(TreeJoint(before.after, slides, int(follows[0]), factor, offset, placement))
        at.append(_FramePlace(len(joints), aligned.inverse(), True))
    return tuple(joints), at


def _to_z(axis: FloatArray) -> FloatArray:
    """A rotation whose z axis is `axis` (3,), with entries 0 and 1 if `axis` is x, y or z."""
    first = np.cross(np.roll(np.eye(3)[np.argmax(np.abs(axis))], 1), axis)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first), axis], axis=1)


def _limits(mechanism: Mechanism) -> list[tuple[int, bool, float, float]]:
    """Limits of passive joints, widened by the allowed margin; a whole turn is no limit."""
    limits = []
    for k, (low, high) in enumerate(zip(mechanism.lower.tolist(), mechanism.upper.tolist(), strict=True)):
        turns = bool(mechanism.passive_repeats[k])
        if (turns and high - low < _LARGEST_TURN) or (not turns and np.isfinite([low, high]).any()):
            limits.append((k, turns, low - LIMIT_MARGIN, high + LIMIT_MARGIN))
    return limits
