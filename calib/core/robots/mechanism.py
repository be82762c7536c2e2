"""The robot as a Pinocchio model: one placement per URDF origin, and which joints each frame depends on.

Pinocchio folds fixed joints into their parents, so their origins could not be calibrated. Here every joint of the URDF
becomes a joint of one degree of freedom, those that do not move being held at zero; joint `i` then has exactly one
placement, `model.jointPlacements[i]`, which is the origin in the file. Two kinds of origin are added that the file
does not have: `base` (the measurement frame in the link it is attached to) and one per target (the measured point).
Because each link is the child of one joint, links, frames and joints share one index.

Joint values. The user gives the actuated ones; a loop decides the passive ones; the rest is held:

    q_all = E_actuated q_actuated + E_passive q_passive + q_constant

with selection matrices E that also hold `<mimic>` multipliers, so that a follower joint moves with its leader.

Where a joint term tilts the link behind a joint (`calib.core.robots.terms.term`), that link hangs on joints of
its own, one for each rotation that the joint itself does not make. They are given like the actuated ones and come after
them in q_actuated; they are not commanded, and their values follow from the commands.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays
from calib.core.base.errors import DescriptionError, require_known
from calib.core.base.units import Dimension


@dataclass(frozen=True)
class RelativeFrame:
    """Frame b seen from frame a: what a loop closure constrains and what a tracker measures.

    Attributes:
        name: For messages.
        a, b: Joint indices of the two frames (0 is the root link).
        full_pose: False: the translation of b in a counts; True: log6 of the relative pose (loops of type 6d).
        rows: Indices of the constrained components, of x, y, z(, rx, ry, rz), in the axes of frame a.
    """

    name: str
    a: int
    b: int
    full_pose: bool
    rows: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class JointSubset:
    """The joints that decide some pairs of frames: those that move both frames of every pair alike are left out.

    They cancel, but for rounding: coordinates of size L are wrong by eps L, so that a robot that stands kilometres from
    the root link's origin would otherwise lose the digits that closed loops need. Joints of other branches cost time.

    Attributes:
        joints: Indices of the origins that stay, parents first, (n_reduced,).
        places: Number of each frame among them, from 1; 0 for a frame that does not move, (n_joints + 1,).
        parents: `places` of the frame before each origin that stays, (n_reduced,).
        model: The model of these alone, all origins at zero.
    """

    joints: IntArray
    places: IntArray
    parents: IntArray
    model: pin.Model


def flat_poses(poses: Any) -> FloatArray:
    """Return a view of Pinocchio's vector of poses as numbers, (n, 12): rotations column by column, then positions.

    No other function reads the memory of C++, where the elements of a vector follow each other, and so do the two parts
    of each. Asking Pinocchio for each pose of each joint takes several times as long as computing them.
    """
    return np.lib.stride_tricks.as_strided(poses[0].rotation.T, (len(poses), 12), (_POSE_BYTES, 8))


def _bytes_of_pose() -> int:
    """Distance of poses in a vector of Pinocchio [byte], checked."""
    poses = pin.StdVec_SE3()
    poses.extend([pin.SE3.Identity()] * 2)
    first, position, second = (
        array.__array_interface__["data"][0] for array in (poses[0].rotation, poses[0].translation, poses[1].rotation)
    )
    assert position - first == 72
    assert poses[0].rotation.strides == (8, 24)
    return int(second - first)


_POSE_BYTES = _bytes_of_pose()


def rigid(xyz: tuple[float, ...], rpy: tuple[float, ...]) -> pin.SE3:
    """Return an origin as a URDF has it [m], [rad] as a rigid transform."""
    return pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array(xyz))


def perpendicular_axes(axis: FloatArray) -> FloatArray:
    """Return two unit vectors perpendicular to a unit vector (3,) and to each other, (2, 3)."""
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(axis, first)])


def view(places: Mapping[str, int], a: str, b: str) -> RelativeFrame:
    """Return place b seen from place a, from the joint index of each place."""
    return RelativeFrame(f"{a}-{b}", places[a], places[b], True, (0, 1, 2, 3, 4, 5))


@dataclass(frozen=True, eq=False)
class Mechanism(ReadOnlyArrays):
    """Pinocchio model of a robot plus its loops and targets. Arrays are read-only; pickles.

    Attributes:
        model: Pinocchio model with one joint per URDF joint, then `base` and the targets.
        origin_names: Name of origin i; its joint index is i + 1.
        frames: Joint index of every link, and of every joint (the index of the link behind it), by name.
        actuated, passive: Names of the joints that the user gives, and that the loops decide.
        tilts: Names of the joints that tilt links.
        select_actuated, select_passive: E of the module docstring, (n_joints, n_driven or n_passive).
        constant: Value of each joint that is neither, (n_joints,).
        lower, upper: Limits of the passive joints [m or rad], (n_passive,).
        loops: Closures, in the order of the description.
        targets: Each target seen from the measurement frame.
        places: Joint index of every place that instruments look from or at, by name.
        views: Pairs of frames that instruments look along.
        support: `support[i, j]` is 1.0 where joint j + 1 moves frame i, (n_joints + 1, n_joints).
        axes: Motion of each joint per unit of its value, [linear; angular] in its own frame, (n_joints, 6).
        length: Characteristic length that makes metres and radians comparable [m].
    """

    model: pin.Model
    origin_names: tuple[str, ...]
    frames: dict[str, int]
    actuated: tuple[str, ...]
    passive: tuple[str, ...]
    tilts: tuple[str, ...]
    dimensions: dict[str, Dimension]
    select_actuated: FloatArray
    select_passive: FloatArray
    constant: FloatArray
    lower: FloatArray
    upper: FloatArray
    loops: tuple[RelativeFrame, ...]
    targets: tuple[RelativeFrame, ...]
    places: dict[str, int]
    views: tuple[RelativeFrame, ...]
    support: FloatArray
    axes: FloatArray
    length: float

    @property
    def n_joints(self) -> int:
        """Number of joints, which is also the number of origins."""
        return len(self.origin_names)

    @cached_property
    def driven(self) -> tuple[str, ...]:
        """Names of the actuated joints, then of those that tilt links."""
        return self.actuated + self.tilts

    @cached_property
    def is_tilt(self) -> BoolArray:
        """Mask of the driven joints that tilt links, (n_driven,)."""
        return np.arange(len(self.driven)) >= len(self.actuated)

    @cached_property
    def depths(self) -> IntArray:
        """Number of actuated joints that move the link behind each of them, itself included, (n_actuated,)."""
        moving = np.any(self.select_actuated[:, : len(self.actuated)] != 0.0, axis=1)
        return np.rint(self.support[[self.frames[name] for name in self.actuated]] @ moving).astype(np.intp)

    def without_tilts(self, actuated: FloatArray) -> FloatArray:
        """Return the driven joints, (n, n_driven), where no link is tilted, from the actuated ones (n, n_actuated)."""
        return np.pad(actuated, ((0, 0), (0, len(self.tilts)))) if self.tilts else actuated

    def joint(self, name: str) -> int:
        """Return the index of a link's or joint's frame; an unknown name is a `DescriptionError`."""
        require_known(name, self.frames, "no link or joint", DescriptionError)
        return self.frames[name]

    def origin(self, place: str) -> str:
        """Return the name of the origin of a place."""
        return self.origin_names[self.places[place] - 1]

    def placement(self, origin: str) -> pin.SE3:
        """Return a copy of an origin's placement, parent link to joint."""
        return self.model.jointPlacements[self.origin_names.index(origin) + 1].copy()

    def with_placements(self, placements: dict[str, pin.SE3]) -> Mechanism:
        """Return a mechanism in which the named origins have these placements."""
        model = self.model.copy()
        for name, placement in placements.items():
            model.jointPlacements[self.origin_names.index(name) + 1] = placement
        return self._with(forgotten=("placements", "_models"), model=model)

    def reduced_to(self, pairs: tuple[RelativeFrame, ...]) -> JointSubset:
        """Return the part of the model that decides these pairs, the same for all placements of a mechanism."""
        if pairs not in self._reductions:
            signs = np.array([self.direction_signs(pair) for pair in pairs]).reshape(-1, self.n_joints)
            moving, frames = signs.any(axis=0), self.model.parents.tolist()
            places = np.concatenate([[0], np.cumsum(moving)])
            for joint in np.flatnonzero(~moving):
                places[joint + 1] = places[frames[joint + 1]]
            joints, model = np.flatnonzero(moving), pin.Model()
            parents = places[[frames[joint + 1] for joint in joints]]
            for index, parent in zip(joints.tolist(), parents.tolist(), strict=True):
                model.addJoint(parent, self.model.joints[index + 1], pin.SE3.Identity(), self.origin_names[index])
            self._reductions[pairs] = JointSubset(joints, places, parents, model)
        return self._reductions[pairs]

    def model_around(self, pairs: tuple[RelativeFrame, ...]) -> pin.Model:
        """Return Pinocchio's model of `reduced_to`, with the origins of this mechanism; nobody may change it."""
        if pairs not in self._models:
            reduced = self.reduced_to(pairs)
            model = reduced.model.copy()
            flat_poses(model.jointPlacements)[1:] = self.placements[reduced.joints]
            self._models[pairs] = model
        return self._models[pairs]

    @cached_property
    def _reductions(self) -> dict[tuple[RelativeFrame, ...], JointSubset]:
        return {}

    @cached_property
    def _models(self) -> dict[tuple[RelativeFrame, ...], pin.Model]:
        return {}

    @cached_property
    def placements(self) -> FloatArray:
        """All origins as `flat_poses`, (n_joints, 12)."""
        return flat_poses(self.model.jointPlacements)[1:].copy()

    def twists_before(self, twists: FloatArray) -> FloatArray:
        """Return Ad(placement) xi, twists of origins in the frames before them, (n_joints, 6, k).

        xi are (6 n_joints, k), of all origins.
        """
        n = self.n_joints
        rotation = self.placements[:, :9].reshape(n, 3, 3).transpose(0, 2, 1)
        x, y, z = self.placements[:, 9:].T[:, :, None]
        along, across, up = rotation.transpose(1, 0, 2)
        action = np.zeros((n, 6, 6))
        action[:, :3, :3] = action[:, 3:, 3:] = rotation
        action[:, :3, 3:] = np.stack([y * up - z * across, z * along - x * up, x * across - y * along], axis=1)
        return np.matmul(action, twists.reshape(n, 6, -1))

    def interpolated(self, other: Mechanism, part: float) -> Mechanism:
        """Return the mechanism whose origins have moved by this part (0 to 1) of the way to those of `other`."""
        start, end = self.model.jointPlacements, other.model.jointPlacements
        moved = {
            name: pin.SE3.Interpolate(start[k + 1], end[k + 1], part)
            for k, name in enumerate(self.origin_names)
            if start[k + 1] != end[k + 1]
        }
        return self.with_placements(moved)

    def all_joints(self, actuated: FloatArray, passive: FloatArray) -> FloatArray:
        """Assemble q_all of the module docstring, (n_poses, n_joints), from the driven and the passive joints."""
        return actuated @ self.select_actuated.T + passive @ self.select_passive.T + self.constant

    def direction_signs(self, relative: RelativeFrame) -> FloatArray:
        """Return +1 for joints that move only b, -1 for those that move only a, else 0, (n_joints,)."""
        return self.support[relative.b] - self.support[relative.a]

    @cached_property
    def moved_targets(self) -> tuple[RelativeFrame, ...]:
        """Targets that motors move, seen from the measurement frame: not a board that a camera on the arm looks at."""
        driven = np.any(self.select_moving, axis=1)
        return tuple(target for target in self.targets if np.any(driven & (self.direction_signs(target) != 0)))

    @cached_property
    def loop_signs(self) -> FloatArray:
        """`direction_signs` of the loop of each closure row, (n_rows, n_joints)."""
        signs = [self.direction_signs(loop) for loop in self.loops for _ in loop.rows]
        return np.array(signs).reshape(-1, self.n_joints)

    @cached_property
    def loop_rows(self) -> IntArray:
        """Joint indices of frames a and b, and the coordinate, of each closure row, (n_rows, 3)."""
        rows = [(loop.a, loop.b, row) for loop in self.loops for row in loop.rows]
        return np.array(rows, dtype=np.intp).reshape(-1, 3)

    @cached_property
    def select_moving(self) -> FloatArray:
        """E of the passive joints, then of the driven ones, (n_joints, n_passive + n_driven)."""
        return np.hstack([self.select_passive, self.select_actuated])

    @cached_property
    def is_seen(self) -> BoolArray:
        """Mask of the joints that move a target, a view or a loop, (n_joints,)."""
        pairs = self.targets + self.views + self.loops
        return np.any([self.direction_signs(pair) != 0 for pair in pairs], axis=0)

    def _slides(self, names: tuple[str, ...]) -> BoolArray:
        return np.array([self.dimensions[name] == "length" for name in names], dtype=bool)

    @cached_property
    def turning(self) -> BoolArray:
        """Mask of the actuated joints that turn, (n_actuated,)."""
        return ~self._slides(self.actuated)

    @cached_property
    def actuated_repeats(self) -> BoolArray:
        """Mask of the actuated joints that are in the same pose a whole turn later, (n_actuated,)."""
        return self._repeats(self.select_actuated[:, : len(self.actuated)])

    @cached_property
    def passive_repeats(self) -> BoolArray:
        """Mask of the passive joints that are in the same pose a whole turn later, (n_passive,)."""
        return self._repeats(self.select_passive)

    def _repeats(self, select: FloatArray) -> BoolArray:
        """Where all joints that follow, by `select` (n_joints, k), turn, and by whole turns, (k,)."""
        turns = np.array([self.dimensions.get(name) != "length" for name in self.origin_names])[:, None]
        whole: BoolArray = turns & (select == np.round(select))
        return np.all(whole | (select == 0.0), axis=0)

    @cached_property
    def joint_scale(self) -> FloatArray:
        """Scale of each actuated joint: 1 [rad], or the characteristic length [m], (n_actuated,)."""
        return self.driven_scale[: len(self.actuated)]

    @cached_property
    def driven_scale(self) -> FloatArray:
        """Scale of each driven joint, as of an actuated one, (n_driven,)."""
        return np.where(self._slides(self.driven), self.length, 1.0)

    @cached_property
    def passive_scale(self) -> FloatArray:
        """Scale of each passive joint, as of an actuated one, (n_passive,)."""
        return np.where(self.is_metre_column, self.length, 1.0)

    @cached_property
    def is_metre_row(self) -> BoolArray:
        """Mask of the closure rows that are lengths, (n_rows,)."""
        return np.array([row < 3 for loop in self.loops for row in loop.rows], dtype=bool)

    @cached_property
    def is_metre_column(self) -> BoolArray:
        """Mask of the passive joints that slide, (n_passive,)."""
        return self._slides(self.passive)
