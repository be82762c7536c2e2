"""The common source of the simulator formats: the calibrated URDF, an assembled configuration, and ties of loops.

A tie joins two links, in a point or as whole frames. Everything is computed from the numbers in the text of the
calibrated URDF, so an exported robot gives the same model to the last bit when it is loaded again.

Servos of the exported motors are as stiff as a simulator can hold. A position servo under a load sags by
load / stiffness. The stiffness here follows from the inertia at the motor, so that every robot, light or heavy, sags by
the acceleration of gravity over (2 pi f)^2: at 100 Hz, about 0.03 mm where gravity acts fully along the motion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import InputError
from calib.core.base.sections import ANGLE_COMPONENTS
from calib.core.numerics import linalg
from calib.core.results.urdf import with_inserted
from calib.core.robots.closure import residual
from calib.core.robots.mechanism import rigid
from calib.core.robots.robot import Robot
from calib.core.robots.robot_files import urdf_of_origins
from calib.core.robots.urdf.reader import HELD_TYPES
from calib.core.robots.urdf.text import UrdfText, parse_urdf
from calib.core.robots.urdf.writing import quote_attribute
from calib.exporting.gap import Gap, free_joints, loop_gaps, require_small
from calib.shared.links import read_links

_FREE_MASS, _FREE_INERTIA = 1e-3, 1e-6
"""Mass [kg] and moments of inertia [kg m^2] of the links between free joints: the least that simulators can handle."""
_SLIDE_LIMIT = 1.0  # limit of an added slide [m]
SERVO_FREQUENCY = 100.0
"""Undamped frequency of the position servos at home, with critical damping [Hz]."""
_LEAST_INERTIA = 1e-9


@dataclass(frozen=True, eq=False)
class Tie:
    """A connection of two links.

    Attributes:
        name: Name of the closure.
        a, b: Links.
        full_pose: True: `a` is fixed to `b` at `placement`. False: only the origin of `a` is fixed.
        placement: Pose of link `a` in link `b`, at home.
    """

    name: str
    a: str
    b: str
    full_pose: bool
    placement: pin.SE3


@dataclass(frozen=True, eq=False)
class Marker:
    """A named point on a link: a target or the measurement frame, at its current place."""

    name: str
    link: str
    placement: pin.SE3


@dataclass(frozen=True, eq=False)
class ClosedModel:
    """A robot for a simulator.

    Attributes:
        urdf: Calibrated URDF, with free joints added where requested.
        home: Value of every moving joint in an assembled configuration [m or rad].
        inertia: Inertia at each motor at home, loops closed, the other motors at rest [kg or kg m^2].
        ties: Ties that close the loops.
        gaps: Gaps that the ties have to absorb; empty with free joints.
        markers: Targets and measurement frame.
        robot: The original robot.
    """

    urdf: UrdfText
    home: dict[str, float]
    inertia: tuple[float, ...]
    ties: tuple[Tie, ...]
    gaps: tuple[Gap, ...]
    markers: tuple[Marker, ...]
    robot: Robot


def closed_model(robot: Robot, *, free_slide: bool = False) -> ClosedModel:
    """Return the common source of the simulator formats.

    Args:
        robot: The robot, with its current values.
        free_slide: Add a joint for each direction that a closure leaves free, so that ties absorb no gaps.

    Raises:
        InputError: A tie would block a motion of the mechanism, or no joint has exactly the free motions.
    """
    robot = robot.with_terms(())  # the formats hold no joint terms
    urdf = parse_urdf(urdf_of_origins(robot), robot.urdf.path)
    home = home_values(robot)
    gaps = loop_gaps(robot)
    ends = [(link_of(urdf, a), link_of(urdf, b)) for a, b in robot.description.closed_loop]
    if free_slide:
        urdf, ends, home = _with_free_joints(robot, urdf, ends, home)
        gaps = ()
    require_small(robot, gaps)
    poses = link_poses(urdf, home)
    names, ties = [loop.name for loop in robot.mechanism.loops], []
    for index, (loop, (a, b)) in enumerate(zip(robot.mechanism.loops, ends, strict=True)):
        name = loop.name if names.count(loop.name) == 1 else f"{loop.name}_{index}"
        ties.append(Tie(name, a, b, loop.full_pose, poses[b].actInv(poses[a])))
    return ClosedModel(urdf, home, motor_inertia(robot, urdf), tuple(ties), gaps, _markers(robot), robot)


def home_values(robot: Robot) -> dict[str, float]:
    """Return the value of every moving joint in the home configuration, loops closed [m or rad]."""
    configurations = robot.assemble(robot.home)
    joints = robot.mechanism.all_joints(configurations.actuated, configurations.passive)[0]
    index = {name: i for i, name in enumerate(robot.mechanism.origin_names)}
    return {joint.name: float(joints[index[joint.name]]) for joint in robot.urdf.joints if joint.type not in HELD_TYPES}


def link_poses(urdf: UrdfText, values: dict[str, float]) -> dict[str, pin.SE3]:
    """Return the pose of every link in the root link; joints without a value are at zero."""
    poses = {urdf.root: pin.SE3.Identity()}
    for joint in urdf.joints_from_root:
        motion = joint_motion(joint.type, joint.axis, values.get(joint.name, 0.0))
        poses[joint.child] = poses[joint.parent] * rigid(joint.xyz, joint.rpy) * motion
    return poses


def joint_motion(kind: str, axis: tuple[float, ...], value: float) -> pin.SE3:
    """Return the transform of a joint at a value [m or rad], relative to its origin."""
    if kind in HELD_TYPES or value == 0:
        return pin.SE3.Identity()
    if kind == "prismatic":
        return pin.SE3(np.eye(3), value * np.array(axis))
    return pin.SE3(pin.exp3(value * np.array(axis)), np.zeros(3))


def tie_lines(model: ClosedModel) -> list[str]:
    """Return remarks on the loops for the user, as lines of a comment."""
    if not model.ties:
        return []
    lines = ["simulators close loops only approximately; take important poses from calib predict"]
    if not model.gaps:
        return lines
    return [
        *lines,
        "a closure here constrains fewer directions than a 3D constraint does:",
        *(f"  {gap.text()}" for gap in model.gaps),
        "  (the constraint contains the gap at home; the variant with free slides avoids the other gaps)",
    ]


def link_of(urdf: UrdfText, frame: str) -> str:
    """Return the link of a frame in the description; a joint's name means its child.

    Raises:
        InputError: There is neither a link nor a joint of that name.
    """
    if frame in urdf.links:
        return frame
    child = next((joint.child for joint in urdf.joints if joint.name == frame), None)
    if child is None:
        raise InputError(f"{urdf.path}: frame '{frame}' is neither a link nor a joint of the URDF; name one of these")
    return child


def _markers(robot: Robot) -> tuple[Marker, ...]:
    mechanism, description = robot.mechanism, robot.description
    places = [("measurement_frame", description.base.frame, mechanism.targets[0].a)]
    for target in mechanism.targets:
        places.append((f"target_{target.name}", description.targets[target.name].frame, target.b))
    return tuple(
        Marker(name, link_of(robot.urdf, frame), mechanism.model.jointPlacements[index].copy())
        for name, frame, index in places
    )


def _with_free_joints(
    robot: Robot, urdf: UrdfText, ends: list[tuple[str, str]], home: dict[str, float]
) -> tuple[UrdfText, list[tuple[str, str]], dict[str, float]]:
    """Put free joints behind the first link of each closure, and tie the last of these to the second link."""
    poses = link_poses(urdf, home)
    parts, new_ends, new_home = [], [], dict(home)
    for index, (a, b) in enumerate(ends):
        relative = poses[a].actInv(poses[b])
        parent = a
        for direction in free_joints(robot, index):
            name, turns = f"{a}_to_{b}_free_{direction}", direction in ANGLE_COMPONENTS
            moved = pin.log3(relative.rotation) if turns else relative.translation
            new_home[name] = float(moved["xyz".index(direction[-1])])
            parts.append(_free_joint(name, parent, direction[-1], turns))
            parent = f"{name}_link"
        new_ends.append((parent, b))
    if not parts:
        return urdf, ends, home
    text = "\n".join(["", "  <!-- Free joints: the loops are closed behind them. -->", *parts, ""])
    return parse_urdf(with_inserted(urdf, text, at=urdf.end), urdf.path), new_ends, new_home


def _free_joint(name: str, parent: str, axis: str, turns: bool) -> str:
    kind = "continuous" if turns else "prismatic"
    limit = "" if turns else f'lower="-{_SLIDE_LIMIT}" upper="{_SLIDE_LIMIT}" '
    vector = " ".join("1" if axis == other else "0" for other in "xyz")
    child = quote_attribute(f"{name}_link")
    moments = " ".join(f'i{a}{b}="{_FREE_INERTIA if a == b else 0}"' for a, b in ("xx", "xy", "xz", "yy", "yz", "zz"))
    return (
        f'  <joint name={quote_attribute(name)} type="{kind}">\n'
        f"    <parent link={quote_attribute(parent)}/>\n    <child link={child}/>\n"
        f'    <axis xyz="{vector}"/>\n    <limit {limit}effort="0" velocity="10"/>\n  </joint>\n'
        f"  <link name={child}>\n"
        f'    <inertial><mass value="{_FREE_MASS}"/><inertia {moments}/></inertial>\n  </link>'
    )


def motor_inertia(robot: Robot, urdf: UrdfText) -> tuple[float, ...]:
    """Return the inertia at each motor at home, loops closed and the other motors at rest [kg or kg m^2].

    With dq = E da for the motors' rates da (passive joints follow through the loops), it is the diagonal of E^T M E.
    """
    mechanism = robot.mechanism
    model = mechanism.model.copy()
    for name, link in read_links(urdf).items():
        if link.inertial is not None and link.inertial.mass > 0 and mechanism.frames.get(name, 0) > 0:
            body = pin.Inertia(link.inertial.mass, link.inertial.centre, possible_inertia(link.inertial.inertia))
            model.appendBodyToJoint(mechanism.frames[name], body, pin.SE3.Identity())
    configurations = robot.assemble(robot.home)
    joints = mechanism.all_joints(configurations.actuated, configurations.passive)[0]
    rates = mechanism.select_actuated
    if mechanism.passive:
        _, by_passive, by_actuated = residual(mechanism, configurations.actuated, configurations.passive)
        rates = rates - mechanism.select_passive @ np.linalg.solve(by_passive[0], by_actuated[0])
    mass = pin.crba(model, model.createData(), joints)
    mass = np.triu(mass) + np.triu(mass, 1).T
    return tuple(float(value) for value in np.diag(rates.T @ mass @ rates))


def servo_gains(inertia: float) -> tuple[float, float]:
    """Return stiffness and damping of a critically damped servo [N/m, N s/m or N m, N m s], six digits each."""
    rate, inertia = 2 * math.pi * SERVO_FREQUENCY, max(inertia, _LEAST_INERTIA)
    return float(f"{rate**2 * inertia:.6g}"), float(f"{2 * rate * inertia:.6g}")


def possible_inertia(inertia: FloatArray) -> FloatArray:
    """Return the nearest physically possible inertia: positive moments, none above the sum of the other two.

    `inertia` is about the centre of mass, (3, 3) [kg m^2], symmetric.
    """
    moments, axes = linalg.eigh(inertia)
    fixed = np.maximum(moments, max(1e-6 * float(moments[2]), 1e-12))
    excess = fixed[2] - fixed[0] - fixed[1]
    if excess > 0:
        fixed[:2] += excess / 2 * (1 + 1e-9) + 1e-15
    if np.array_equal(fixed, moments):
        return inertia
    result: FloatArray = axes @ np.diag(fixed) @ axes.T
    return (result + result.T) / 2
