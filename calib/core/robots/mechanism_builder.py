"""From a URDF and its description to a `Mechanism`: the tree in Pinocchio, and the role of each joint."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import BoolArray, FloatArray
from calib.core.base.errors import DescriptionError, UrdfError, nearest, require_known
from calib.core.base.sections import ANGLE_COMPONENTS, COMPONENTS
from calib.core.base.units import Dimension, quantity
from calib.core.base.words import count_noun
from calib.core.instruments.kind import Instrument, Place
from calib.core.robots.described_instruments import MEASUREMENT_FRAME, pair_names, places_of
from calib.core.robots.description import Description
from calib.core.robots.mechanism import Mechanism, RelativeFrame, rigid, view
from calib.core.robots.terms.term import tilts_of
from calib.core.robots.terms.terms import TERMS
from calib.core.robots.urdf.reader import HELD_TYPES, UNSUPPORTED_TYPES, UrdfJoint
from calib.core.robots.urdf.text import UrdfText, require_supported

Loops = tuple[RelativeFrame, ...]


def build_mechanism(
    urdf: UrdfText,
    description: Description,
    instruments: tuple[Instrument, ...],
    where: str,
) -> Mechanism:
    """Build the mechanism of a URDF and its description; a joint that mimics itself is a `UrdfError`.

    `DescriptionError` for an unknown name, an unsupported joint on the way to what is measured, or loops that do not
    determine the passive joints.
    """
    model, frames, tilts = _tree(urdf, tilted_joints(description))
    origin_names = list(model.names[1:])
    indices: dict[str, int] = {}
    for place in places_of(description, instruments, where):
        link = _frame(frames, place.link, f"{where}: {_entry(place, description)}.frame")
        origin = _new_name(*_origin_names(place), origin_names)
        pose = rigid(place.xyz, place.rpy)
        indices[place.name] = int(
            model.addJoint(link, pin.JointModelRX(), pose.inverse() if place.inverted else pose, origin)
        )
        origin_names.append(origin)
        if not place.inverted:
            frames.setdefault(place.name, indices[place.name])
    base = indices[MEASUREMENT_FRAME]
    targets = [RelativeFrame(name, base, indices[name], False, (0, 1, 2)) for name in description.targets]
    views = dict.fromkeys(pair for instrument in instruments for pair in pair_names(description, instrument))
    seen = tuple(view(indices, a, b) for a, b in views)
    support = _support(model)
    loops = tuple(_loop(description, frames, index, where) for index in range(len(description.closed_loop)))
    between = np.array([support[pair.b] != support[pair.a] for pair in (*targets, *seen, *loops)])
    names = {name for name, moves in zip(origin_names, between.T, strict=True) if np.any(moves)}
    require_supported([joint for joint in urdf.joints if joint.name in names], where)
    in_loop = np.any([support[loop.b] != support[loop.a] for loop in loops] or [[False] * len(origin_names)], axis=0)
    groups = _joint_groups(urdf, description, origin_names, in_loop, where)
    _check_count(groups.passive, loops, where)
    return Mechanism(
        model=model,
        origin_names=tuple(origin_names),
        frames=frames,
        actuated=groups.actuated,
        passive=groups.passive,
        tilts=tilts,
        dimensions={name: _dimension(joint) for name, joint in groups.moving.items()} | dict.fromkeys(tilts, "angle"),
        lower=np.array([groups.moving[name].lower for name in groups.passive]),
        upper=np.array([groups.moving[name].upper for name in groups.passive]),
        loops=loops,
        targets=tuple(targets),
        places=indices,
        views=seen,
        support=support,
        axes=_axes(model),
        length=_length(model, support, targets, loops),
        **_selection(urdf, groups, tilts, origin_names, home_values(urdf, description, where)),
    )


def tilted_joints(description: Description) -> tuple[str, ...]:
    """Return the actuated joints with a term that tilts the link behind them."""
    named = {section.joint for section in description.terms if TERMS[section.term].tilts}
    return tuple(name for name in description.name_mot if named & {name, "all"})


def _axes(model: pin.Model) -> FloatArray:
    """The motion of each joint per unit of its value, [linear; angular] in its own frame, (n_joints, 6)."""
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    return np.array([np.asarray(data.joints[i].S).reshape(6) for i in range(1, model.njoints)])


def home_values(urdf: UrdfText, description: Description, where: str) -> dict[str, float]:
    """Return the home configuration by joint name [m or rad]; joints that it does not name are absent.

    `DescriptionError` if a joint is unknown, or a value has the wrong dimension.
    """
    moving = _moving(urdf)
    values = {}
    for name, value in description.home.items():
        require_known(name, moving, f"{where}: home: no moving joint", DescriptionError)
        values[name] = quantity(value, _dimension(moving[name]), f"{where}: home.{name}", DescriptionError)
    return values


def _entry(place: Place, description: Description) -> str:
    """The place in the description, in words."""
    if place.name in description.targets:
        return f"targets.{place.name}"
    return "base" if place.inverted else f"place '{place.name}'"


def _origin_names(place: Place) -> tuple[str, str]:
    """Names for the origin of a place: the first choice, then others if that is taken."""
    if not place.inverted:
        return place.name, f"{place.name}_point"
    later = place.name.removeprefix(MEASUREMENT_FRAME)
    return f"base{later}", f"measurement_base{later}"


def _moving(urdf: UrdfText) -> dict[str, UrdfJoint]:
    return {joint.name: joint for joint in urdf.joints if joint.type not in HELD_TYPES}


def _dimension(joint: UrdfJoint) -> Dimension:
    return "length" if joint.type == "prismatic" else "angle"


def _tree(urdf: UrdfText, tilted: Collection[str]) -> tuple[pin.Model, dict[str, int], tuple[str, ...]]:
    """Return the model, the joint index of every link and joint (if both have one name, the link's), and the tilts."""
    model = pin.Model()
    frames = {urdf.root: 0}
    indices: dict[str, int] = {}
    tilts: list[str] = []
    for joint in urdf.joints_from_root:
        axis = np.array(joint.axis)
        kind: pin.JointModel = pin.JointModelRX()
        if joint.type == "prismatic":
            kind = pin.JointModelPrismaticUnaligned(axis)
        elif joint.type not in HELD_TYPES:
            kind = pin.JointModelRevoluteUnaligned(axis)
        index = int(model.addJoint(frames[joint.parent], kind, rigid(joint.xyz, joint.rpy), joint.name))
        for name, direction in _tilts(joint) if joint.name in tilted else ():
            index = int(model.addJoint(index, pin.JointModelRevoluteUnaligned(direction), pin.SE3.Identity(), name))
            tilts.append(name)
        indices[joint.name] = frames[joint.child] = index
    return model, indices | frames, tuple(tilts)


def _tilts(joint: UrdfJoint) -> Iterator[tuple[str, FloatArray]]:
    """The name and axis of each tilt of a joint: two across its axis, and if it slides, one about its axis."""
    axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    first /= np.linalg.norm(first)
    directions = [first, np.cross(axis, first), *([axis] if joint.type == "prismatic" else [])]
    return zip(tilts_of(joint.name, _dimension(joint)), directions, strict=True)


def _new_name(name: str, other: str, taken: list[str]) -> str:
    """Return `name`, or if it is taken, `other`, with a _ added until it is new."""
    while name in taken:
        name, other = other, f"{other}_"
    return name


def _frame(frames: Mapping[str, int], name: str, where: str) -> int:
    require_known(name, frames, f"{where}: no link or joint", DescriptionError)
    return frames[name]


def _support(model: pin.Model) -> FloatArray:
    support = np.zeros((model.njoints, model.njoints - 1))
    for index in range(1, model.njoints):
        support[index] = support[model.parents[index]]
        support[index, index - 1] = 1.0
    return support


def _loop(description: Description, frames: Mapping[str, int], index: int, where: str) -> RelativeFrame:
    first, second = description.closed_loop[index]
    where = f"{where}: closed_loop[{index}]"
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


@dataclass(frozen=True)
class _JointGroups:
    """The role of each joint: moved by the user, by the loops, or by another joint that it mimics; the rest is held.

    Attributes:
        moving: Joints that can move, by name.
        actuated, passive: Their names.
        followers: Leader, multiplier and offset of each joint that mimics another one.
    """

    moving: dict[str, UrdfJoint]
    actuated: tuple[str, ...]
    passive: tuple[str, ...]
    followers: dict[str, tuple[str, float, float]]


def _joint_groups(
    urdf: UrdfText, description: Description, origin_names: list[str], in_loop: BoolArray, where: str
) -> _JointGroups:
    moving = _moving(urdf)
    types = {joint.name: joint.type for joint in urdf.joints}
    actuated = tuple(description.name_mot)
    for name in actuated:
        if name not in types:
            raise DescriptionError(f"{where}: name_mot: no joint '{name}'{nearest(name, moving)}")
        if types[name] in UNSUPPORTED_TYPES:
            require_supported([joint for joint in urdf.joints if joint.name == name], f"{where}: name_mot")
        if name not in moving:
            raise DescriptionError(f"{where}: name_mot: joint '{name}' is {types[name]}, it does not move")
    followers = {
        name: joint.mimic for name, joint in moving.items() if joint.mimic is not None and name not in actuated
    }
    passive = tuple(
        name
        for name, inside in zip(origin_names, in_loop, strict=True)
        if inside and name in moving and name not in actuated and name not in followers
    )
    return _JointGroups(moving, actuated, passive, followers)


def _check_count(passive: tuple[str, ...], loops: Loops, where: str) -> None:
    n_rows = sum(len(loop.rows) for loop in loops)
    if n_rows != len(passive):
        raise DescriptionError(
            f"{where}: the closures constrain {count_noun(n_rows, 'direction')} but leave"
            f" {count_noun(len(passive), 'passive joint')}"
            f" ({', '.join(passive) or 'none'}); they must be equal: check name_mot, and constrain in closed_loop_axes"
            " only what the mechanism constrains (y and z for a planar loop about x)"
        )


def _selection(
    urdf: UrdfText, groups: _JointGroups, tilts: tuple[str, ...], origin_names: list[str], home: Mapping[str, float]
) -> dict[str, Any]:
    """Return the selection matrices and the constant of `Mechanism`."""
    driven = groups.actuated + tilts
    select_actuated = np.zeros((len(origin_names), len(driven)))
    select_passive = np.zeros((len(origin_names), len(groups.passive)))
    constant = np.zeros(len(origin_names))
    for i, name in enumerate(origin_names):
        leader, multiplier, constant[i] = _leader(urdf, groups, name)
        if leader in driven:
            select_actuated[i, driven.index(leader)] = multiplier
        elif leader in groups.passive:
            select_passive[i, groups.passive.index(leader)] = multiplier
        elif leader in home:
            constant[i] += multiplier * home[leader]
    return {"select_actuated": select_actuated, "select_passive": select_passive, "constant": constant}


def _leader(urdf: UrdfText, groups: _JointGroups, name: str) -> tuple[str, float, float]:
    """Follow mimics of mimics: the joint at their end, and value = multiplier * its value + offset."""
    leader, multiplier, offset = name, 1.0, 0.0
    followed: list[str] = []
    while leader in groups.followers:
        if leader in followed:
            raise UrdfError(f"{urdf.path}, joint '{name}': mimics itself through {', '.join(followed)}")
        followed.append(leader)
        leader, factor, shift = groups.followers[leader]
        offset, multiplier = offset + multiplier * shift, multiplier * factor
    return leader, multiplier, offset


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
