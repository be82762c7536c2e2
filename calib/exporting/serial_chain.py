"""A robot as the chain of joints from its base link to its first target's link, and the errors of formats.

Controllers compute with such chains. Fixed joints are folded into the links between the moving joints.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import scipy

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import InputError
from calib.core.base.units import quantity_text
from calib.core.robots.mechanism import Mechanism
from calib.core.robots.robot import Robot
from calib.core.robots.urdf.reader import HELD_TYPES, UrdfJoint
from calib.core.robots.urdf.text import UrdfText
from calib.exporting.closed_model import joint_motion, link_of
from calib.exporting.gap import joint_ranges, poses_near_home

_SOBOL = 12  # 2^12 = 4096 poses show an RMS error to 0.1 %
_WITH_LOOPS = 256
_SAME_PLACE = 1e-9  # [m], [rad]


@dataclass(frozen=True)
class SerialChain:
    """The joints with motors between two links.

    Attributes:
        base, tip: The links.
        joints: Moving joints in their order along the chain.
        links: From the base to the first joint frame, from each joint frame to the next, and from the last to the tip.
        point: The first target that motors move, in the tip's frame.
    """

    base: str
    tip: str
    joints: tuple[UrdfJoint, ...]
    links: tuple[pin.SE3, ...]
    point: pin.SE3


def serial_chain(robot: Robot, mechanism: Mechanism) -> SerialChain:
    """Return the chain to the first target of a robot that motors move, in its nominal or its current mechanism.

    Raises:
        InputError: The robot is no chain of joints with motors.
    """
    description = robot.description
    target = (*mechanism.moved_targets, mechanism.targets[0])[0]
    base = link_of(robot.urdf, description.base.frame)
    tip = link_of(robot.urdf, description.targets[target.name].frame)
    joints: list[UrdfJoint] = []
    links = [pin.SE3.Identity()]
    for joint in _joint_path(robot.urdf, base, tip):
        index = mechanism.origin_names.index(joint.name)
        links[-1] = links[-1] * mechanism.model.jointPlacements[index + 1]
        if joint.name in mechanism.actuated:
            joints.append(joint)
            links.append(pin.SE3.Identity())
        elif np.any(mechanism.select_passive[index]) or np.any(mechanism.select_actuated[index]):
            raise InputError(
                f"{robot.urdf.path}: joint '{joint.name}' on the way from {base} to {tip} follows other joints; this"
                " format holds chains in which every joint has a motor, so use urdf, mjcf, drake or toolbox"
            )
        elif joint.type not in HELD_TYPES:
            links[-1] = links[-1] * joint_motion(joint.type, joint.axis, float(mechanism.constant[index]))
    if not joints:
        raise InputError(f"{robot.urdf.path}: no joint with a motor between {base} and {tip}; name another target")
    return SerialChain(base, tip, tuple(joints), tuple(links), mechanism.model.jointPlacements[target.b].copy())


def _joint_path(urdf: UrdfText, base: str, tip: str) -> list[UrdfJoint]:
    parent = {joint.child: joint for joint in urdf.joints}
    way: list[UrdfJoint] = []
    link = tip
    while link != base:
        if link not in parent:
            raise InputError(
                f"{urdf.path}: link '{tip}' is not below '{base}' in the tree; this format starts at the frame of"
                f" '{base}': name a link below its first joint"
            )
        way.insert(0, parent[link])
        link = parent[link].parent
    return way


def rms_text(distances: FloatArray) -> str:
    """Return the root mean square of distances (n, ...) [m], in mm."""
    return quantity_text(float(np.sqrt(np.mean(distances**2))), "mm", ".4g")


def error_text(distances: FloatArray, where: str, angle: float = np.nan) -> str:
    """Return a clause on the errors of the robot in a format, compared with the robot.

    Args:
        distances: Distances of targets, (n_poses, ...) [m].
        where: Region of the poses, in words.
        angle: Largest angle between the tip's frames [rad]; NaN if only positions were compared.
    """
    largest, poses = float(np.max(distances)), f"in {len(distances)} poses {where}"
    if largest < _SAME_PLACE and not angle >= _SAME_PLACE:
        angles = "" if np.isnan(angle) else f", angles within {angle:.1g} rad"
        return f"held exactly: target within {largest:.1g} m{angles} {poses}"
    angles = "" if np.isnan(angle) else f", {quantity_text(angle, 'mrad', '.4g')} at most"
    most = quantity_text(largest, "mm", ".4g")
    return f"error left at the target: {rms_text(distances)} RMS, {most} at most{angles} {poses}"


def judging_poses(robot: Robot) -> tuple[FloatArray, str]:
    """Return the poses for comparing formats, (n, n_actuated) [m or rad], and their region in words.

    They fill the joint ranges evenly (a Sobol sequence, as does every first part of it). With loops, which do not close
    everywhere, they stay within a tenth of the ranges around home.
    """
    if robot.mechanism.loops:
        return poses_near_home(robot, _WITH_LOOPS), "near home"
    lower, upper = joint_ranges(robot)
    return lower + (upper - lower) * scipy.stats.qmc.Sobol(len(lower), scramble=False).random_base2(
        _SOBOL
    ), "over the joint ranges"


def error_left(robot: Robot, chain: SerialChain, forward: Callable[[FloatArray], FloatArray]) -> str:
    """Return a clause on the errors of a format, compared with the robot.

    `forward` gives the format's poses of the tip in the base, (n, 4, 4) [m], from values of the chain's joints, (n,
    n_joints) [m or rad].
    """
    q, where = judging_poses(robot)
    columns = [robot.joint_names.index(joint.name) for joint in chain.joints]
    T_format = forward(q[:, columns])
    base, tip = (robot.forward(q, name) for name in (chain.base, chain.tip))
    T_robot = np.linalg.inv(base) @ tip
    point = np.append(chain.point.translation, 1.0)
    distance = np.linalg.norm(((T_format - T_robot) @ point)[:, :3], axis=1)
    turned = np.linalg.norm(T_format[:, :3, :3] - T_robot[:, :3, :3], axis=(1, 2)) / np.sqrt(8)  # sin(angle / 2)
    angle = float(np.max(2 * np.arcsin(np.minimum(turned, 1.0))))
    return error_text(distance, where, angle)
