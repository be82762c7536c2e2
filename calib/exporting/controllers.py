"""Files for controllers and ROS: Denavit-Hartenberg tables, joint zeros, Universal Robots' kinematics, xacro origins.

Most of these files hold less than the calibrated robot. Each states in its comment what it holds, and the error at the
target that remains because loops, joint terms or the tool are missing.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import InputError
from calib.core.base.units import DISPLAY_UNIT, in_unit, millimetres
from calib.core.base.words import listing
from calib.core.calibrating.file_robots import with_zeros
from calib.core.data.in_memory import as_measurements
from calib.core.data.measurements import Measurements
from calib.core.data.table_writing import format_table
from calib.core.fitting.fit import fit_data
from calib.core.fitting.settings import Settings
from calib.core.instruments.position import Position, PositionSection
from calib.core.results.urdf import comment, provenance_lines, source_lines
from calib.core.robots.accuracy_of_files import Holds
from calib.core.robots.file_formats import FormatFile, error_comparison
from calib.core.robots.joint_errors import actual_joints, term_columns
from calib.core.robots.robot import Robot
from calib.core.robots.robot_files import without_terms
from calib.core.robots.urdf.writing import number_attribute
from calib.core.rows.registration import register
from calib.exporting.dh_tables import dh_table, format_dh, table_poses
from calib.exporting.serial_chain import SerialChain, error_left, error_text, judging_poses, rms_text, serial_chain
from calib.exporting.toolbox import yaml_with_comments
from calib.shared.denavit_hartenberg import Convention, DhRow, Kind
from calib.shared.ur_calibration import JOINTS, KEYS, LINKS

_EXACT = 1e-9  # noise of predicted positions [m]: so small that priors decide only what positions leave open
_NOTHING = 1e-12  # smaller offsets are zero [m or rad]
_FITTED = 0.25  # part of the poses from which offsets are found; the others give their error


def dh_file(robot: Robot, convention: Convention, provenance: Sequence[str] = ()) -> FormatFile:
    """Return the Denavit-Hartenberg table of a robot's chain as CSV.

    Raises:
        InputError: The robot is no chain of joints with motors.
    """
    chain = serial_chain(robot, robot.mechanism)
    turns = [_z_to(joint.axis) for joint in chain.joints]
    before = [pin.SE3.Identity(), *turns]
    after = [*turns, pin.SE3.Identity()]
    links = [a.inverse() * link * b for a, link, b in zip(before, chain.links, after, strict=True)]
    kinds: list[Kind] = ["prismatic" if joint.type == "prismatic" else "revolute" for joint in chain.joints]
    joints = [
        DhRow(joint.name, kind, lower=joint.lower, upper=joint.upper)
        for joint, kind in zip(chain.joints, kinds, strict=True)
    ]
    table = dh_table(links, joints, convention)
    statement = f"{_chain_text(robot, chain)}: {error_left(robot, chain, partial(table_poses, table))}"
    along, across = "Rot z(theta) Trans z(d)", "Trans x(a) Rot x(alpha) Rot y(beta)"
    product = f"{along} {across}" if convention == "standard" else f"{across} {along}"
    lines = [
        f"the pose of {chain.tip} in {chain.base} is the product of the rows in their order, each {product};",
        "sign * q adds to theta of revolute joints and to d of prismatic ones; base and tool do not move",
    ]
    hayati = "beta is Hayati's angle between nearly parallel axes; a controller without it cannot hold the table"
    lines += [hayati] if any(row.beta for row in table.rows) else []
    lines += [statement, _tool_text(chain), *provenance_lines(robot), *provenance]
    return FormatFile(format_dh(table, lines).encode(), statement)


def _z_to(axis: Sequence[float]) -> pin.SE3:
    """The shortest rotation that takes z to a unit axis."""
    quaternion = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), np.array(axis))
    return pin.SE3(quaternion.toRotationMatrix(), np.zeros(3))


def _chain_text(robot: Robot, chain: SerialChain) -> str:
    text = f"holds the {len(chain.joints)} joints from {chain.base} to {chain.tip}"
    missing = [name for name in robot.joint_names if name not in [joint.name for joint in chain.joints]]
    if missing:
        text += f", and not {listing(missing)}"
    return text + _terms_text(robot)


def _terms_text(robot: Robot) -> str:
    joints = list(dict.fromkeys(term.joint for term in robot.terms))
    return f", no joint terms (of {listing(joints)})" if joints else ""


def _tool_text(chain: SerialChain) -> str:
    xyz = " ".join(f"{millimetres(float(value)):.6f}" for value in chain.point.translation)
    return f"the target is at {xyz} mm in {chain.tip}; it is not in this file"


def ur_kinematics(robot: Robot, provenance: Sequence[str] = ()) -> FormatFile:
    """Return the kinematics YAML of `ur_description`, Universal Robots' ROS description.

    The file has the six joint origins; the first is in `base_link_inertia`, or in the link under the shoulder.
    Calibrated changes of earlier fixed joints go into the first origin. Of changes behind wrist_3, the last origin
    takes a rotation about the last axis, and a shift along it; the file cannot hold the others.

    Raises:
        InputError: The robot is not made by `ur_description`.
    """
    chain, nominal = (serial_chain(robot, mechanism) for mechanism in (robot.mechanism, robot.nominal))
    _check_ur(robot, chain)
    # nominal pose in the base of the link under the shoulder
    mount = nominal.links[0] * robot.nominal.placement(nominal.joints[0].name).inverse()
    tail, calibrated_tail = nominal.links[-1], chain.links[-1]
    turned = calibrated_tail.rotation @ tail.rotation.T
    theta = float(np.arctan2(turned[1, 0] - turned[0, 1], turned[0, 0] + turned[1, 1]))
    shift = np.array([0.0, 0.0, float(calibrated_tail.translation[2] - tail.translation[2])])
    last = chain.links[-2] * pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, theta), shift)
    origins = [mount.inverse() * chain.links[0], *chain.links[1:-2], last]
    left = error_left(robot, chain, _product([mount * origins[0], *origins[1:], tail]))
    statement = f"holds the six joint origins, nothing behind wrist_3{_terms_text(robot)}: {left}"
    lines = [
        "calib: kinematics for ur_description (argument kinematics_params of ur.urdf.xacro)",
        statement,
        _tool_text(chain),
        "hash: it differs from the controller's hash, so that the driver sees that these are not factory values",
        *provenance_lines(robot),
        *provenance,
    ]
    content: dict[str, object] = {
        name: dict(zip(KEYS, _xyz_rpy(origin), strict=True)) for name, origin in zip(LINKS, origins, strict=True)
    }
    return FormatFile(yaml_with_comments(lines, {"kinematics": {**content, "hash": "measured_by_calib"}}), statement)


def _xyz_rpy(origin: pin.SE3) -> list[float]:
    values = (*origin.translation, *pin.rpy.matrixToRpy(origin.rotation))
    return [float(value) + 0.0 for value in values]  # no -0.0


def has_ur_kinematics(robot: Robot) -> bool:
    """Return whether a robot is made by `ur_description`."""
    try:
        _check_ur(robot, serial_chain(robot, robot.nominal))
    except InputError:
        return False
    return True


def _check_ur(robot: Robot, chain: SerialChain) -> None:
    """Raise `InputError` unless the chain is that of ur_description: six joints about z, no fixed joints between."""
    names = [joint.name for joint in chain.joints]
    prefix = names[0].removesuffix(JOINTS[0]) if names[0].endswith(JOINTS[0]) else ""
    expected = [prefix + name for name in JOINTS]
    hint = "make the URDF with 'xacro ur.urdf.xacro ur_type:=... name:=ur' of ur_description, and calibrate that"
    if names != expected:
        raise InputError(
            f"{robot.urdf.path}: format 'ur-kinematics' needs the joints {', '.join(expected)}, not"
            f" {', '.join(names)}; {hint}"
        )
    for k, joint in enumerate(chain.joints):
        if joint.axis != (0.0, 0.0, 1.0):
            raise InputError(f"{robot.urdf.path}, joint '{joint.name}': its axis is not 0 0 1; {hint}")
        if k and joint.parent != chain.joints[k - 1].child:
            raise InputError(
                f"{robot.urdf.path}, joint '{joint.name}': is not attached to the link of the joint before it; {hint}"
            )


def _product(links: Sequence[pin.SE3]) -> Callable[[FloatArray], FloatArray]:
    """Function from joint values (n, n_joints) to poses (n, 4, 4) of a chain of joints about z between these links."""

    def forward(q: FloatArray) -> FloatArray:
        poses = []
        for row in q:
            pose = links[0]
            for angle, link in zip(row, links[1:], strict=True):
                pose = pose * pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, float(angle)), np.zeros(3)) * link
            poses.append(pose.homogeneous)
        return np.array(poses)

    return forward


def joint_offsets(robot: Robot, provenance: Sequence[str] = ()) -> FormatFile:
    """Return a sign and a zero correction for each joint with a motor, and the error that remains with them.

    For a fit, they reproduce its measurements best; otherwise they bring the nominal model nearest to the robot.
    """
    file_robot, placed = robot.files.get(Holds.ZEROS), any(p.placement for p in robot.parameters)
    anew = ", base and target placed anew" if placed else ""
    if file_robot is None:
        q, where = judging_poses(robot)
        signs, offsets, errors, before = _joint_zeros(robot, q)
        reached = f"{error_text(errors, where)}; the nominal model without them has {rms_text(before)} RMS"
    else:
        signs, offsets, reached = file_robot.signs, file_robot.offsets, error_comparison(robot, Holds.ZEROS)
    statement = f"holds one zero and a sign for each joint{anew}: {reached}"
    lines = [
        f"calib: joint zeros of {robot.name}: a joint is at sign * q + offset where the controller says q",
        statement,
        *(provenance_lines(robot) if file_robot is None else source_lines(robot)),
        *provenance,
    ]
    units = [DISPLAY_UNIT[robot.mechanism.dimensions[name]] for name in robot.joint_names]
    columns: list[tuple[str, Sequence[object]]] = [
        ("joint", robot.joint_names),
        ("sign", [f"{sign:.0f}" for sign in signs]),
        ("offset", [in_unit(float(value), unit) for value, unit in zip(offsets, units, strict=True)]),
        ("unit", units),
    ]
    return FormatFile(format_table(columns, lines).encode(), statement)


def xacro_origins(robot: Robot, provenance: Sequence[str] = ()) -> FormatFile:
    """Return a xacro file with properties `JOINT_xyz` and `JOINT_rpy` for every joint of the URDF.

    Raises:
        InputError: Two joints would get the same properties.
    """
    lines, owner = [], dict[str, str]()
    for joint in robot.urdf.joints:
        name = re.sub(r"\W", "_", joint.name, flags=re.ASCII)
        if owner.setdefault(name, joint.name) != joint.name:
            raise InputError(
                f"{robot.urdf.path}: joints '{owner[name]}' and '{joint.name}' would both be xacro properties"
                f" {name}_xyz; rename one"
            )
        placement = robot.mechanism.placement(joint.name)
        same = placement == robot.nominal.placement(joint.name)
        xyz, rpy = (joint.xyz, joint.rpy) if same else (placement.translation, pin.rpy.matrixToRpy(placement.rotation))
        lines.append(f'  <xacro:property name="{name}_xyz" value="{number_attribute(xyz)}"/>')
        lines.append(f'  <xacro:property name="{name}_rpy" value="{number_attribute(rpy)}"/>')
    statement = f"holds every joint origin exactly{_terms_text(robot)}; no base or target position"
    head = comment(["calib: joint origins for a xacro to include", statement, *provenance_lines(robot), *provenance])
    first = '<?xml version="1.0"?>\n<robot xmlns:xacro="http://www.ros.org/wiki/xacro">'
    text = "\n".join([first, head, *lines, "</robot>"])
    return FormatFile(f"{text}\n".encode("ascii"), statement)


def _joint_zeros(robot: Robot, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """The joint zeros that bring the nominal model nearest to a robot without a fit.

    The nominal model is fitted to positions that the robot predicts, by the same method as the zeros of a fit's files
    (`calib.core.calibrating.file_robots`). Free are the zeros, and base and targets if the description calls them
    unknown. Errors that base or target can explain as well as a zero are left to base or target. Poses at which loops
    of the nominal model do not close are dropped.

    Args:
        q: Poses, (n, n_joints) [m or rad]; the offsets are found from the first of them, a part of `_FITTED`.

    Returns:
        For each joint, sign and offset in sign * q + offset, (n_joints,) [m or rad]. Errors of each target with and
        without these zeros, (n_poses, n_targets) [m].
    """
    positions = robot.positions(q)
    actual = actual_joints(robot, q, term_columns(robot, q))[:, : q.shape[1]]
    signs = np.where(np.sum((q - q.mean(axis=0)) * (actual - actual.mean(axis=0)), axis=0) < 0, -1.0, 1.0)
    reading = tuple(Position.from_section(name, PositionSection(kind="position")) for name in robot.target_names)
    plain = replace(without_terms(robot, Holds.ZEROS).with_nominal_values(), instruments=reading)
    some = np.flatnonzero(plain.close(signs * q).ok)[: int(np.ceil(_FITTED * len(q)))]
    found = fit_data(with_zeros(plain), Settings(sigma=_EXACT), _read(plain, signs * q[some], positions[some])).robot
    offsets = found.values[found.coefficients]
    offsets = np.where(np.abs(offsets) < _NOTHING, 0.0, offsets)
    return signs, offsets, _errors(plain, signs * q + offsets, positions), _errors(plain, q, positions)


def _read(robot: Robot, q: FloatArray, positions: FloatArray) -> Measurements:
    return as_measurements(robot, q, {name: positions[:, k] for k, name in enumerate(robot.target_names)})


def _errors(plain: Robot, q: FloatArray, positions: FloatArray) -> FloatArray:
    """Error of each target after placing base and targets for these poses, (n_closed, n_targets) [m]."""
    closes = plain.close(q).ok
    placed = register(plain, _read(plain, q[closes], positions[closes]))
    return np.linalg.norm(placed.positions(q[closes]) - positions[closes], axis=2)
