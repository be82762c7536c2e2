"""`robot.yaml`: a file for Pinocchio's toolbox-parallel-robots beside a URDF, and a robot description for `calib`.

The toolbox reads `closed_loop`, `type` and `name_mot`, and ignores the rest, which describes the calibrated robot: its
assembled home, the fitted poses of base and targets, and the parametrisation.

The toolbox holds all three directions of a `3d` closure, even those that `closed_loop_axes` leaves free.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin
import yaml

from calib.core.results.urdf import provenance_lines
from calib.core.robots.description import Description
from calib.core.robots.robot import Robot
from calib.exporting.closed_model import home_values
from calib.exporting.gap import loop_gaps


def calibrated_description(robot: Robot, urdf_name: str) -> Description:
    """Return the description for the calibrated URDF, with assembled home and the fitted poses of base and targets."""
    description, mechanism = robot.description, robot.mechanism
    changes: dict[str, Any] = {"urdf": urdf_name}
    if mechanism.loops:
        moving = home_values(robot.with_terms(()))
        listed = dict.fromkeys((*mechanism.actuated, *mechanism.passive, *description.home))
        changes["home"] = {name: moving[name] for name in listed}
    base = mechanism.targets[0].a
    if _has_moved(robot, base):
        placement = mechanism.model.jointPlacements[base].inverse()  # the description has the link's pose in the base
        xyz, rpy = (tuple(part.tolist()) for part in (placement.translation, pin.rpy.matrixToRpy(placement.rotation)))
        changes["base"] = description.base.model_copy(update={"xyz": xyz, "rpy": rpy})
    targets = {target.name: description.targets[target.name] for target in mechanism.targets}
    for target in mechanism.targets:
        if _has_moved(robot, target.b):
            place = tuple(mechanism.model.jointPlacements[target.b].translation.tolist())
            targets[target.name] = targets[target.name].model_copy(update={"xyz": place})
    changes["targets"] = targets
    return description.model_copy(update=changes)


def toolbox_yaml(robot: Robot, urdf_name: str, provenance: Sequence[str] = ()) -> bytes:
    """Return `robot.yaml`, with comments; the toolbox expects the URDF beside it to be called `robot.urdf`."""
    description = calibrated_description(robot, urdf_name)
    lines = ["calib: robot description, for Pinocchio's toolbox-parallel-robots as well", *provenance]
    lines += provenance_lines(robot)
    gaps = loop_gaps(robot)
    if gaps:
        lines += ["the toolbox constrains all directions of a closure; calib only those of closed_loop_axes:"]
        lines += [f"  {gap.text()}" for gap in gaps]
    content = description.model_dump(mode="json", exclude_defaults=True)
    content = {key: content[key] for key in Description.model_fields if key in content}
    for key in ("closed_loop", "type"):  # the toolbox requires both keys
        content.setdefault(key, [])
    return yaml_with_comments(lines, content, allow_unicode=True, width=10**6, default_flow_style=None)


def _has_moved(robot: Robot, index: int) -> bool:
    before, after = robot.nominal.model.jointPlacements[index], robot.mechanism.model.jointPlacements[index]
    return not np.array_equal(before.homogeneous, after.homogeneous)


class _ExactDumper(yaml.SafeDumper):
    """YAML with floats that read back exactly, also in programs that require a point before the exponent."""


def _float(dumper: yaml.SafeDumper, value: float) -> yaml.ScalarNode:
    text = repr(value)
    if "e" in text and "." not in text:
        text = text.replace("e", ".0e")
    return dumper.represent_scalar("tag:yaml.org,2002:float", text)


_ExactDumper.add_representer(float, _float)


def yaml_with_comments(lines: Sequence[str], content: object, **style: Any) -> bytes:
    """Return content as YAML whose floats read back exactly, after lines of comment."""
    text = yaml.dump(content, Dumper=_ExactDumper, sort_keys=False, **style)
    return ("".join(f"# {line}\n" for line in lines) + text).encode()
