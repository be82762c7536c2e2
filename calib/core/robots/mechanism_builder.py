"""From a URDF and its description to a `Mechanism`: the tree in Pinocchio, and the role of each joint."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import DescriptionError, UrdfError, nearest, require_known
from calib.core.base.sections import ANGLE_COMPONENTS, COMPONENTS
from calib.core.base.units import Dimension, quantity
from calib.core.base.words import count_noun
from calib.core.instruments.kind import Instrument, Place
from calib.core.robots.described_instruments import MEASUREMENT_FRAME, pair_names, places_of
from calib.core.robots.description import Description
from calib.core.robots.mechanism import Mechanism, RelativeFrame, perpendicular_axes, rigid, view
from calib.core.robots.terms.term import tilts_of
from calib.core.robots.terms.terms import TERMS
from calib.core.robots.urdf.reader import HELD_TYPES, UrdfJoint
from calib.core.robots.urdf.text import UrdfText, require_supported

Loops = tuple[RelativeFrame, ...]
Mimics = Mapping[str, tuple[str, float, float]]


def build_mechanism(
    urdf: UrdfText, description: Description, instruments: tuple[Instrument, ...], where: str
) -> Mechanism:
    """Build the mechanism of a URDF and its description; a joint that mimics itself is a `UrdfError`.

    `DescriptionError` for an unknown name, an unsupported joint on the way to what is measured, or loops that do not
    determine the passive joints.
    """
    model, frames, tilts = _tree(urdf, tilted_joints(description))
    origin_names = list(model.names[1:])
    places: dict[str, int] = {}
    for place in places_of(description, instruments, where):
        link = _frame(frames, place.link, f"{where}: {_entry(place, description)}.frame")
        origin = _new_origin(place, origin_names)
        pose = rigid(place.xyz, place.rpy)
        pose = pose.inverse() if place.inverted else pose
        places[place.name] = int(model.addJoint(link, pin.JointModelRX(), pose, origin))
        origin_names.append(origin)
        if not place.inverted:
            frames.setdefault(place.name, places[place.name])
    base = places[MEASUREMENT_FRAME]
    targets = tuple(RelativeFrame(name, base, places[name], False, (0, 1, 2)) for name in description.targets)
    pairs = dict.fromkeys(pair for instrument in instruments for pair in pair_names(description, instrument))
    views = tuple(view(places, a, b) for a, b in pairs)
    loops = tuple(_loop(description, frames, index, where) for index in range(len(description.closed_loop)))
    support = _support(model)
    between = np.array([support[pair.b] != support[pair.a] for pair in (*targets, *views, *loops)])
    names = {name for name, moves in zip(origin_names, between.T, strict=True) if np.any(moves)}
    require_supported([joint for joint in urdf.joints if joint.name in names], where)
    moving = _moving(urdf)
    _check_motors(urdf, description, where)
    mimics = {
        name: joint.mimic
        for name, joint in moving.items()
        if joint.mimic is not None and name not in description.name_mot
    }
    in_loop = np.any(between[len(between) - len(loops) :], axis=0)
    decided = moving.keys() - mimics.keys() - {*description.name_mot}
    passive = tuple(name for name, inside in zip(origin_names, in_loop, strict=True) if inside and name in decided)
    _check_count(passive, loops, where)
    given, n_driven = (*description.name_mot, *tilts, *passive), len(description.name_mot) + len(tilts)
    select, constant = _selection(urdf, mimics, given, origin_names, home_values(urdf, description, where))
    return Mechanism(
        model=model,
        origin_names=tuple(origin_names),
        frames=frames,
        actuated=description.name_mot,
        passive=passive,
        tilts=tilts,
        dimensions={name: _dimension(joint) for name, joint in moving.items()} | dict.fromkeys(tilts, "angle"),
        select_actuated=select[:, :n_driven],
        select_passive=select[:, n_driven:],
        constant=constant,
        lower=np.array([moving[name].lower for name in passive]),
        upper=np.array([moving[name].upper for name in passive]),
        loops=loops,
        targets=targets,
        places=places,
        views=views,
        support=support,
        axes=_axes(model),
        length=_length(model, support, targets, loops),
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


def _new_origin(place: Place, taken: list[str]) -> str:
    """A name for the origin of a place: the first choice, or others if that is taken."""
    later = place.name.removeprefix(MEASUREMENT_FRAME)
    name, other = (
        (f"base{later}", f"measurement_base{later}") if place.inverted else (place.name, f"{place.name}_point")
    )
    while name in taken:
        name, other = other, f"{other}_"
    return name


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
    directions = [*perpendicular_axes(axis), *([axis] if joint.type == "prismatic" else [])]
    return zip(tilts_of(joint.name, _dimension(joint)), directions, strict=True)


def _frame(frames: Mapping[str, int], name: str, where: str) -> int:
    require_known(name, frames, f"{where}: no link or joint", DescriptionError)
    return frames[name]


def _support(model: pin.Model) -> FloatArray:
    support = np.zeros((model.njoints, model.njoints - 1))
    for frame, joints in enumerate(model.supports):
        support[frame, [joint - 1 for joint in joints if joint]] = 1.0
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
    a, b = (_frame(frames, name, where) for name in (first, second))
    return RelativeFrame(f"{first}-{second}", a, b, full_pose, tuple(COMPONENTS.index(axis) for axis in axes))


def _check_motors(urdf: UrdfText, description: Description, where: str) -> None:
    """Raise `DescriptionError` for an actuated joint that there is not, or that does not move."""
    joints = {joint.name: joint for joint in urdf.joints}
    for name in description.name_mot:
        if name not in joints:
            raise DescriptionError(f"{where}: name_mot: no joint '{name}'{nearest(name, _moving(urdf))}")
        require_supported([joints[name]], f"{where}: name_mot")
        if joints[name].type in HELD_TYPES:
            raise DescriptionError(f"{where}: name_mot: joint '{name}' is {joints[name].type}, it does not move")


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
    urdf: UrdfText, mimics: Mimics, given: tuple[str, ...], origin_names: list[str], home: Mapping[str, float]
) -> tuple[FloatArray, FloatArray]:
    """Return the matrix that selects `given` joints, (n_joints, n_given), and the constant of `Mechanism`."""
    select, constant = np.zeros((len(origin_names), len(given))), np.zeros(len(origin_names))
    for i, name in enumerate(origin_names):
        leader, multiplier, constant[i] = _leader(urdf, mimics, name)
        if leader in given:
            select[i, given.index(leader)] = multiplier
        else:
            constant[i] += multiplier * home.get(leader, 0.0)
    return select, constant


def _leader(urdf: UrdfText, mimics: Mimics, name: str) -> tuple[str, float, float]:
    """Follow mimics of mimics: the joint at their end, and value = multiplier * its value + offset."""
    leader, multiplier, offset = name, 1.0, 0.0
    followed: list[str] = []
    while leader in mimics:
        if leader in followed:
            raise UrdfError(f"{urdf.path}, joint '{name}': mimics itself through {', '.join(followed)}")
        followed.append(leader)
        leader, factor, shift = mimics[leader]
        offset, multiplier = offset + multiplier * shift, multiplier * factor
    return leader, multiplier, offset


def _length(model: pin.Model, support: FloatArray, targets: Loops, loops: Loops) -> float:
    """Longest origin translation inside a loop, or on the way to a target, as the robot's characteristic length [m]."""
    sizes = np.array([np.linalg.norm(placement.translation) for placement in model.jointPlacements[1:]])
    inside = max((float(np.max(sizes * (support[pair.b] != support[pair.a]))) for pair in loops), default=0.0)
    reach = max(float(np.sum(sizes * support[target.b])) for target in targets)
    return inside or reach or 1.0
