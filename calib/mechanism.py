"""The robot as Pinocchio sees it: one placement per URDF origin, and which joints each frame depends on.

Pinocchio folds fixed joints into their parents, so their origins could not be calibrated. Here every joint of the URDF
becomes a joint of one degree of freedom, those that do not move being held at zero; joint `i` then has exactly one
placement, `model.jointPlacements[i]`, which is the origin in the file. Two kinds of origin are added that the file
does not have: `base` (the measurement frame in the link it is attached to) and one per target (the measured point).
Because each link is the child of one joint, links, frames and joints share one index.

Joint values. The user gives the actuated ones; a loop decides the passive ones; the rest is held:

    q_all = E_actuated q_actuated + E_passive q_passive + q_constant

with selection matrices E that also hold `<mimic>` multipliers, so that a follower joint moves with its leader.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.description import ANGLE_COMPONENTS, COMPONENTS, Description
from calib.errors import DescriptionError, UrdfError, nearest
from calib.units import Dimension, quantity
from calib.urdf_text import HELD_TYPES, UrdfJoint, UrdfText

FloatArray = NDArray[np.floating[Any]]
IntArray = NDArray[np.intp]
BoolArray = NDArray[np.bool_]


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
class Mechanism:
    """Pinocchio model of a robot plus its loops and targets. Arrays are read-only; pickles.

    Attributes:
        model: Pinocchio model with one joint per URDF joint, then `base` and the targets.
        origin_names: Name of origin i; its joint index is i + 1.
        frames: Joint index of every link and joint name.
        actuated, passive: Names of the joints that the user gives, and that the loops decide.
        select_actuated, select_passive: E of the module docstring, (n_joints, n_actuated or n_passive).
        constant: Value of each joint that is neither, (n_joints,).
        lower, upper: Limits of the passive joints [m or rad], (n_passive,).
        loops: Closures, in the order of the description.
        targets: Each target seen from the measurement frame.
        support: `support[i, j]` is 1.0 where joint j + 1 moves frame i, (n_joints + 1, n_joints).
        length: Characteristic length that makes metres and radians comparable [m].
    """

    model: pin.Model
    origin_names: tuple[str, ...]
    frames: dict[str, int]
    actuated: tuple[str, ...]
    passive: tuple[str, ...]
    dimensions: dict[str, Dimension]
    select_actuated: FloatArray
    select_passive: FloatArray
    constant: FloatArray
    lower: FloatArray
    upper: FloatArray
    loops: tuple[RelativeFrame, ...]
    targets: tuple[RelativeFrame, ...]
    support: FloatArray
    length: float

    @property
    def n_joints(self) -> int:
        """Number of joints, which is also the number of origins."""
        return len(self.origin_names)

    def joint(self, name: str) -> int:
        """Return the index of a link's or joint's frame; an unknown name is an error."""
        if name not in self.frames:
            raise DescriptionError(f"no link or joint '{name}'{nearest(name, self.frames)}")
        return self.frames[name]

    def placement(self, origin: str) -> pin.SE3:
        """Return a copy of an origin's placement, parent link to joint."""
        return self.model.jointPlacements[self.origin_names.index(origin) + 1].copy()

    def with_placements(self, placements: dict[str, pin.SE3]) -> Mechanism:
        """Return a mechanism in which the named origins have these placements."""
        model = self.model.copy()
        for name, placement in placements.items():
            model.jointPlacements[self.origin_names.index(name) + 1] = placement
        values = {key: getattr(self, key) for key in self.__dataclass_fields__} | {"model": model}
        return Mechanism(**values)

    def all_joints(self, actuated: FloatArray, passive: FloatArray) -> FloatArray:
        """Assemble q_all of the module docstring, (n_poses, n_joints)."""
        return actuated @ self.select_actuated.T + passive @ self.select_passive.T + self.constant

    def between(self, relative: RelativeFrame) -> FloatArray:
        """Return +1 for joints that move only b, -1 for those that move only a, else 0, (n_joints,)."""
        difference: FloatArray = self.support[relative.b] - self.support[relative.a]
        return difference

    @cached_property
    def is_metre_row(self) -> BoolArray:
        """Which closure rows are lengths, (n_rows,)."""
        return np.array([row < 3 for loop in self.loops for row in loop.rows], dtype=bool)

    @cached_property
    def is_metre_column(self) -> BoolArray:
        """Which passive joints slide, (n_passive,)."""
        return np.array([self.dimensions[name] == "length" for name in self.passive], dtype=bool)


@dataclass(frozen=True, eq=False)
class _JointSelection:
    """The attributes of a `Mechanism` that say which joint is what."""

    actuated: tuple[str, ...]
    passive: tuple[str, ...]
    dimensions: dict[str, Dimension]
    select_actuated: FloatArray
    select_passive: FloatArray
    constant: FloatArray
    lower: FloatArray
    upper: FloatArray


def build_mechanism(urdf: UrdfText, description: Description) -> Mechanism:
    """Build the mechanism of a URDF and its description.

    Raises:
        DescriptionError: A name that the URDF does not have, or loops that do not determine the passive joints.
    """
    model, frames = _tree(urdf)
    origin_names = [joint.name for joint in _topological(urdf)]
    where = description.urdf
    base_link = _frame(frames, description.base.frame, f"{where}: base.frame")
    base_name = "base" if "base" not in origin_names else "measurement_base"
    T_measurement_link = _pose(description.base.xyz, description.base.rpy)
    base = int(model.addJoint(base_link, pin.JointModelRX(), T_measurement_link.inverse(), base_name))
    origin_names.append(base_name)
    targets = []
    for name, section in description.targets.items():
        link = _frame(frames, section.frame, f"{where}: targets.{name}.frame")
        origin = name if name not in origin_names else f"{name}_point"
        index = int(model.addJoint(link, pin.JointModelRX(), _pose(section.xyz, (0.0, 0.0, 0.0)), origin))
        origin_names.append(origin)
        frames.setdefault(name, index)
        targets.append(RelativeFrame(name, base, index, False, (0, 1, 2)))
    support = _support(model)
    loops = tuple(_loop(description, frames, index) for index in range(len(description.closed_loop)))
    joints = _joint_selection(urdf, description, origin_names, support, loops)
    mechanism = Mechanism(
        model=model,
        origin_names=tuple(origin_names),
        frames=frames,
        loops=loops,
        targets=tuple(targets),
        support=support,
        length=_length(model, support, targets, loops),
        **vars(joints),
    )
    for array in (
        mechanism.select_actuated,
        mechanism.select_passive,
        mechanism.constant,
        mechanism.lower,
        mechanism.upper,
        mechanism.support,
    ):
        array.flags.writeable = False
    return mechanism


def _topological(urdf: UrdfText) -> list[UrdfJoint]:
    """Joints so that parents come first, otherwise in file order."""
    children: dict[str, list[UrdfJoint]] = {link: [] for link in urdf.links}
    for joint in urdf.joints:
        children[joint.parent].append(joint)
    root = next(link for link in urdf.links if all(joint.child != link for joint in urdf.joints))
    order: list[UrdfJoint] = []
    waiting = [root]
    while waiting:
        found = children[waiting.pop(0)]
        order.extend(found)
        waiting = [joint.child for joint in found] + waiting
    return order


def _tree(urdf: UrdfText) -> tuple[pin.Model, dict[str, int]]:
    model = pin.Model()
    joints = _topological(urdf)
    root = next(link for link in urdf.links if all(joint.child != link for joint in urdf.joints))
    frames = {root: 0}
    for joint in joints:
        axis = np.array(joint.axis)
        kind: pin.JointModel = pin.JointModelRX()
        if joint.type == "prismatic":
            kind = pin.JointModelPrismaticUnaligned(axis)
        elif joint.type not in HELD_TYPES:
            kind = pin.JointModelRevoluteUnaligned(axis)
        index = model.addJoint(frames[joint.parent], kind, _pose(joint.xyz, joint.rpy), joint.name)
        frames[joint.child] = index
    for joint in joints:
        frames.setdefault(joint.name, model.getJointId(joint.name))
    return model, frames


def _pose(xyz: tuple[float, ...], rpy: tuple[float, ...]) -> pin.SE3:
    return pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array(xyz))


def _frame(frames: dict[str, int], name: str, where: str) -> int:
    if name not in frames:
        raise DescriptionError(f"{where}: no link or joint '{name}'{nearest(name, frames)}")
    return frames[name]


def _support(model: pin.Model) -> FloatArray:
    support = np.zeros((model.njoints, model.njoints - 1))
    for index in range(1, model.njoints):
        support[index] = support[model.parents[index]]
        support[index, index - 1] = 1.0
    return support


def _loop(description: Description, frames: dict[str, int], index: int) -> RelativeFrame:
    first, second = description.closed_loop[index]
    where = f"{description.urdf}: closed_loop[{index}]"
    axes = description.loop_axes(index)
    full_pose = description.type[index] == "6d"
    for axis in axes:
        if axis in ANGLE_COMPONENTS and not full_pose:
            raise DescriptionError(f"{where}: axis '{axis}' is a rotation; that needs type 6d")
    if not axes or len(set(axes)) != len(axes):
        raise DescriptionError(f"{where}: closed_loop_axes {list(axes)} must name each direction once, at least one")
    rows = tuple(COMPONENTS.index(axis) for axis in axes)
    return RelativeFrame(
        f"{first}-{second}", _frame(frames, first, where), _frame(frames, second, where), full_pose, rows
    )


def _joint_selection(
    urdf: UrdfText,
    description: Description,
    origin_names: list[str],
    support: FloatArray,
    loops: tuple[RelativeFrame, ...],
) -> _JointSelection:
    """Decide which joints are actuated, passive or held, and build the selection matrices."""
    joints = {joint.name: joint for joint in urdf.joints}
    moving = {name for name, joint in joints.items() if joint.type not in HELD_TYPES}
    for name in description.name_mot:
        if name not in joints:
            raise DescriptionError(f"{description.urdf}: name_mot: no joint '{name}'{nearest(name, moving)}")
        if name not in moving:
            raise DescriptionError(
                f"{description.urdf}: name_mot: joint '{name}' is {joints[name].type}, it does not move"
            )
    actuated = tuple(description.name_mot)
    if len(set(actuated)) != len(actuated):
        raise DescriptionError(f"{description.urdf}: name_mot names a joint twice")
    in_loop = np.zeros(len(origin_names), dtype=bool)
    for loop in loops:
        in_loop |= support[loop.b] != support[loop.a]
    followers = {name: joints[name].mimic for name in moving if joints[name].mimic and name not in actuated}
    passive = tuple(
        name
        for i, name in enumerate(origin_names)
        if in_loop[i] and name in moving and name not in actuated and name not in followers
    )
    n_rows = sum(len(loop.rows) for loop in loops)
    if n_rows != len(passive):
        raise DescriptionError(
            f"{description.urdf}: the closures constrain {n_rows} directions but leave {len(passive)} passive joints"
            f" ({', '.join(passive) or 'none'}); they must be equal: check name_mot, and constrain in closed_loop_axes"
            " only what the mechanism constrains (y and z for a planar loop about x)"
        )
    home = _home(description, joints, moving)
    select = {group: np.zeros((len(origin_names), len(names))) for group, names in (("a", actuated), ("p", passive))}
    constant = np.zeros(len(origin_names))
    for i, name in enumerate(origin_names):
        multiplier, offset, leader = 1.0, 0.0, name
        seen = set()
        while leader in followers and leader not in seen:
            seen.add(leader)
            leader, factor, shift = followers[leader]  # type: ignore[misc]
            offset, multiplier = offset + multiplier * shift, multiplier * factor
        if leader in followers:
            raise UrdfError(f"{urdf.path}, joint '{name}': mimics itself through {', '.join(sorted(seen))}")
        if leader in actuated:
            select["a"][i, actuated.index(leader)] = multiplier
        elif leader in passive:
            select["p"][i, passive.index(leader)] = multiplier
        elif leader in home:
            offset += multiplier * home[leader]
        constant[i] = offset
    dimensions: dict[str, Dimension] = {
        name: "length" if joints[name].type == "prismatic" else "angle" for name in moving
    }
    return _JointSelection(
        actuated=actuated,
        passive=passive,
        dimensions=dimensions,
        select_actuated=select["a"],
        select_passive=select["p"],
        constant=constant,
        lower=np.array([joints[name].lower for name in passive]),
        upper=np.array([joints[name].upper for name in passive]),
    )


def _home(description: Description, joints: dict[str, UrdfJoint], moving: set[str]) -> dict[str, float]:
    values = {}
    for name, value in description.home.items():
        if name not in moving:
            raise DescriptionError(f"{description.urdf}: home: no moving joint '{name}'{nearest(name, moving)}")
        values[name] = quantity(
            value, "length" if joints[name].type == "prismatic" else "angle", f"{description.urdf}: home.{name}"
        )
    return values


def home_values(urdf: UrdfText, description: Description) -> dict[str, float]:
    """Return the home configuration by joint name [m or rad]; joints that it does not name are absent."""
    joints = {joint.name: joint for joint in urdf.joints}
    return _home(description, joints, {name for name, joint in joints.items() if joint.type not in HELD_TYPES})


def _length(
    model: pin.Model, support: FloatArray, targets: list[RelativeFrame], loops: tuple[RelativeFrame, ...]
) -> float:
    """Longest origin translation inside a loop, or on the way to a target, as the robot's characteristic length [m]."""
    sizes = np.array([float(np.linalg.norm(model.jointPlacements[i].translation)) for i in range(1, model.njoints)])
    inside = [np.max(sizes * (support[pair.b] != support[pair.a])) for pair in loops]
    if inside and max(inside) > 0:
        return float(max(inside))
    reach = max(float(np.sum(sizes * support[target.b])) for target in targets)
    return reach if reach > 0 else 1.0
