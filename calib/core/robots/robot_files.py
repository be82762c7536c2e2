"""The robot that a file holds, its URDF and its description; see `calib.core.robots.accuracy_of_files`."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import ComputationError, InputError
from calib.core.base.files import write_file
from calib.core.base.words import listing
from calib.core.robots.accuracy_of_files import Holds
from calib.core.robots.description import description_yaml
from calib.core.robots.joint_errors import with_terms
from calib.core.robots.robot_data import RobotData, SomeRobot
from calib.core.robots.terms.terms import TERMS
from calib.core.robots.urdf.reader import Triple

_ROUNDING = 1e-14  # a number of the URDF that moves by less has not been edited [m or rad]


def lost_by(robot: RobotData, holds: Holds) -> tuple[str, ...]:
    """Return the joints with terms that are not zero and that a file of this kind loses."""
    lost = (term.joint for term, values in robot.term_values() if not holds.keeps(term) and np.any(values))
    return tuple(dict.fromkeys(lost))


def without_terms(robot: SomeRobot, holds: Holds) -> SomeRobot:
    """Return the robot without the joint terms that files of this kind lose, values unchanged."""
    if not robot.terms:
        return robot
    kept = [section for section in robot.description.terms if holds.keeps(TERMS[section.term])]
    changed = with_terms(robot, kept)
    names = {parameter.name for parameter in changed.parameters}
    held = tuple(name for name in changed.description.held if name in names)
    fleet = changed.description.fleet if changed.terms == robot.terms else None  # its means hold with these terms alone
    return replace(changed, description=changed.description.model_copy(update={"held": held, "fleet": fleet}))


def held_by(robot: SomeRobot, holds: Holds) -> SomeRobot:
    """Return the robot for files of this kind; see `Robot.held_by`."""
    known = robot.files.get(holds)
    if known is None:
        lost = lost_by(robot, holds)
        if lost:
            raise ComputationError(
                f"{robot.path}: a file that holds {holds.value} loses the joint terms of {listing(lost)}, and the"
                " origins here were fitted with these terms. A fit also finds the best origins without them: export"
                " its result folder, or fit again if an earlier version wrote it"
            )
        return robot
    kept = without_terms(robot, holds)
    return kept.with_nominal_values() if len(known.offsets) else kept.with_parameters(known.values)


def urdf_of_origins(robot: RobotData) -> bytes:
    """Return the URDF with the origins of the current values, whatever joint terms go with them; see `UrdfText`."""
    edits: dict[str, tuple[Triple, Triple]] = {}
    for joint in robot.urdf.joints:
        before, after = robot.nominal.placement(joint.name), robot.mechanism.placement(joint.name)
        xyz, rpy = _replace_numbers(joint.xyz, after.translation), joint.rpy
        if not np.array_equal(before.rotation, after.rotation):
            rpy = _replace_numbers(joint.rpy, pin.rpy.matrixToRpy(after.rotation))
        edits[joint.name] = (xyz, rpy)
    return robot.urdf.with_origins(edits)


def write_description(robot: RobotData, path: Path | str, *, force: bool) -> None:
    """Write the robot description; see `Robot.save`."""
    path = Path(path)
    if path.suffix.lower() not in (".yaml", ".yml"):
        raise InputError(
            f"{path}: the name of a robot description ends in .yaml; other formats: calib.export(robot, {path.name!r},"
            " 'urdf')"
        )
    nominal = np.array([parameter.nominal_si for parameter in robot.parameters])
    if not np.array_equal(robot.values, nominal):
        name = robot.parameters[int(np.argmax(robot.values != nominal))].name
        raise InputError(
            f"parameter '{name}' is not nominal, and a description holds nominal values; save the fit, whose folder"
            " loads as a robot, or export a URDF"
        )
    relative = os.path.relpath(Path(robot.urdf.path).resolve(), path.resolve().parent)
    text = description_yaml(robot.description.model_copy(update={"urdf": relative}))
    write_file(path, text, inputs=(robot.path, robot.urdf.path), force=force)


def _replace_numbers(text: Triple, numbers: FloatArray) -> Triple:
    """The numbers (3,), or those of the file if they differ only by rounding."""
    x, y, z = (old if abs(new - old) <= _ROUNDING else float(new) for old, new in zip(text, numbers, strict=True))
    return (x, y, z)
