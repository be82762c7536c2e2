"""Ways to make a robot: from a robot description, from a plain URDF, or from a URDF and keywords."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from calib.core.base.errors import DescriptionError, InputError, require_known
from calib.core.base.registry import load_entry
from calib.core.base.sections import read_yaml
from calib.core.base.units import Dimension, mapped_column, per_si
from calib.core.instruments.kind import Instrument, JointInstrument
from calib.core.robots.described_instruments import instruments_of, places_of
from calib.core.robots.description import (
    BaseSection,
    Description,
    TargetSection,
    read_description,
    validate_description,
)
from calib.core.robots.gravity import check_inclinometers
from calib.core.robots.joint_errors import build_terms
from calib.core.robots.loops import check_home
from calib.core.robots.mechanism import Mechanism
from calib.core.robots.mechanism_builder import build_mechanism, home_values
from calib.core.robots.parametrisation import build_parametrisation, default_sections
from calib.core.robots.robot import Robot
from calib.core.robots.terms.gravity import columns_of
from calib.core.robots.terms.terms import condition_columns
from calib.core.robots.urdf.arm_chain import ArmChain, arm_chain
from calib.core.robots.urdf.text import UrdfText, is_ur_kinematics, read_urdf


def load(path: str | Path) -> Robot:
    """Load a robot from a robot description (YAML), from a plain URDF, or from a calibration of Universal Robots.

    A plain URDF means its arm (see `calib.core.robots.urdf.arm_chain`): every moving joint on the way to the arm's last
    link is actuated, every joint origin from the first of them on may be wrong (with default priors), and neither the
    measurement frame nor the measured point is known beforehand.

    Raises:
        UrdfError: The URDF is not valid.
        DescriptionError: The description is not valid, or does not fit the URDF; or the file is a table.
    """
    path = Path(path)
    if path.suffix.lower() in (".csv", ".xlsx"):
        raise DescriptionError(f"{path}: is a table; the robot comes first: its description or its URDF")
    if path.suffix.lower() in (".yaml", ".yml") and not is_ur_kinematics(read_yaml(path)):
        description = read_description(path)
        urdf = read_urdf(path.parent / description.urdf, description.xacro)
        description = _with_loops(description, urdf)
    else:
        urdf = read_urdf(path)
        description, _ = first_description(urdf, path.name)
    return build(description, urdf, str(path))


def first_description(urdf: UrdfText, urdf_path: str, target: str | None = None) -> tuple[Description, str]:
    """Return the description that a file of a robot stands for, and a remark on the choice.

    That is its arm (to the link `target`, if it is given); with the loops of an MJCF or SDF file, the whole robot.

    Args:
        urdf_path: How the description names the file.

    Raises:
        DescriptionError: There is no such link, or nothing moves it; or loops that do not determine the robot.
    """
    chain, foreign = arm_chain(urdf, target), urdf.foreign
    if not foreign.loops:
        return describe(chain, urdf_path), "; ".join(filter(None, [*foreign.remarks, chain.remark]))
    if not foreign.motors:
        raise DescriptionError(
            f"{urdf.path}: has loops, and no joint has an actuator; add actuators to its motors"
            " (in SDF: a plugin with their joint_name)"
        )
    open_loops = describe(chain, urdf_path).model_copy(update={"name_mot": foreign.motors})
    description, remarks = _with_loops(open_loops, urdf), [*foreign.remarks]
    try:
        build(description, urdf, urdf.path)
    except DescriptionError:
        description = description.model_copy(update={"name_mot": (*foreign.motors, *foreign.springs)})
        if not foreign.springs:
            raise
        build(description, urdf, urdf.path)
        remarks.append(f"springs count as motors, with columns for their deflections: {', '.join(foreign.springs)}")
    return description, "; ".join([*remarks, replace(chain, fingers=(), branches=(), still=()).remark]).strip("; ")


def _with_loops(description: Description, urdf: UrdfText) -> Description:
    """The description with the loops of such a file, if it says nothing of loops."""
    foreign = urdf.foreign
    if not foreign.loops or "closed_loop" in description.model_fields_set:
        return description
    links, kinds, axes = zip(*((loop.links, loop.kind, loop.axes) for loop in foreign.loops), strict=True)
    ends = {"closed_loop": links, "type": kinds, "closed_loop_axes": axes}
    return description.model_copy(update=ends | {"home": foreign.home | description.home})


def describe(chain: ArmChain, urdf_path: str) -> Description:
    """Return the description of a chain of joints in a plain URDF, which it calls `urdf_path`.

    The base is the link that the first moving joint stands on, not the root: if the base is unknown, a fixed joint
    between the two does not matter.
    """
    return Description(
        urdf=urdf_path,
        name_mot=chain.joints,
        base=BaseSection(frame=chain.base, pose="unknown"),
        targets={chain.target: TargetSection(frame=chain.target, position="unknown", sigma=0.5)},
        parametrisation=default_sections(),
    )


def robot(
    urdf: Path | str,
    *,
    motors: Sequence[str] | None = None,
    target: str | Mapping[str, Any] | None = None,
    base: str | Mapping[str, Any] | None = None,
    **keys: Any,
) -> Robot:
    """Make a robot from a URDF without a robot description; what is left out is as for a plain URDF (`load`).

    Args:
        motors: Joints with a motor, in the order of every joint vector.
        target: Link that carries the measured point, whose position there is unknown; or `targets` as in a description.
        base: Link that the robot stands with, whose place in the measurement frame is unknown; or `base` as in a
            description.
        keys: Any other key of a robot description, such as `sigma="0.04 mm"`, `closed_loop`, `home`.

    Raises:
        UrdfError: The URDF is not valid.
        DescriptionError: A key is not valid, or does not fit the URDF.
    """
    if Path(urdf).suffix in (".yaml", ".yml") and not is_ur_kinematics(read_yaml(urdf)):
        raise DescriptionError(f"{urdf}: is a robot description; load it with calib.load({str(urdf)!r})")
    text, where = read_urdf(Path(urdf)), str(urdf)
    content: dict[str, Any] = {"urdf": Path(urdf).name, "parametrisation": default_sections()}
    if motors is None or target is None or base is None:
        plain, _ = first_description(text, Path(urdf).name, target if isinstance(target, str) else None)
        content = {key: getattr(plain, key) for key in plain.model_fields_set}
    if motors is not None:
        content["name_mot"] = motors
    if base is not None:
        content["base"] = {"frame": base, "pose": "unknown"} if isinstance(base, str) else base
    if target is not None:
        content["targets"] = {target: {"frame": target, "position": "unknown"}} if isinstance(target, str) else target
    return build(_with_loops(validate_description(content | keys, urdf), text), text, where)


RobotLike = Robot | Path | str
"""A loaded robot, or the file of its description or URDF."""


def as_robot(robot: RobotLike) -> Robot:
    """Return a robot as it is, or loaded from its file; something else, such as a folder, is an `InputError`."""
    if isinstance(robot, (Path, str)):
        if Path(robot).is_dir():
            raise InputError(f"{robot}: is a folder; the robot of a result is calib.load({str(robot)!r})")
        return load(robot)
    if not isinstance(robot, Robot):
        raise InputError(
            f"robot: expected a Robot, not {type(robot).__name__}; load one with calib.load; a fit has one as .robot"
        )
    return robot


def build(description: Description, urdf: UrdfText, where: str) -> Robot:
    """Put a robot together at its nominal values; a description that does not fit its URDF is a `DescriptionError`."""
    instruments = instruments_of(description, where)
    places = places_of(description, instruments, where)
    nominal = build_mechanism(urdf, description, instruments, where)
    check_inclinometers(description, nominal, where)
    if description.columns:
        _check_columns(description, nominal, instruments, where)
    _check_joints(nominal, instruments, where)
    home = home_values(urdf, description, where)
    mode = check_home(nominal, home, description.singularity_limit, where)
    parametrisation = build_parametrisation(description, urdf, nominal, places, where)
    terms = build_terms(description, urdf, nominal, where)
    robot = Robot(where, description, urdf, nominal, nominal, parametrisation, instruments, terms, np.zeros(0), mode)
    if description.fleet is not None:
        description.fleet.check(robot.parameters, where)
    robot.parameters.places(description.held, f"{where}: held")  # all are known
    robot.parameters.places(description.elimination_order, f"{where}: elimination_order")
    if description.model is not None and description.fleet is None:
        known: Robot = load_entry("calib.methods", "with_model")(robot, description.model)
        return known
    return replace(robot, values=np.array([parameter.nominal_si for parameter in robot.parameters]))


def _check_columns(
    description: Description, mechanism: Mechanism, instruments: tuple[Instrument, ...], where: str
) -> None:
    """Raise `DescriptionError` if a foreign column stands for something that is not read."""
    dimensions: dict[str, Dimension | None] = {name: mechanism.dimensions[name] for name in mechanism.actuated}
    dimensions |= {column.name: column.dimension for instrument in instruments for column in instrument.columns()}
    dimensions |= condition_columns()
    for sensor in description.inclinometers:
        dimensions |= columns_of(sensor)
    labels = {instrument.label_column for instrument in instruments if instrument.label_column is not None}
    texts = {"pose", "setup", *labels, *(name for instrument in instruments for name in instrument.text_columns())}
    taken: dict[str, str] = {}
    for foreign, column in description.columns.items():
        mapped, place = mapped_column(column), f"{where}: columns.{foreign}"
        name, unit = mapped.name, mapped.unit
        if name in taken:
            raise DescriptionError(f"{where}: columns: '{taken[name]}' and '{foreign}' both stand for '{name}'")
        taken[name] = foreign
        if name in texts:
            if unit is not None or not mapped.plain:
                raise DescriptionError(f"{place}: '{name}' holds words; leave out unit, sign and factor")
            continue
        require_known(name, dimensions.keys() | texts, f"{place}: no column", DescriptionError)
        if mapped.factor == 0.0 or not math.isfinite(mapped.factor + mapped.offset):
            raise DescriptionError(
                f"{place}: a factor of zero, or one beyond all numbers, loses the column; correct it"
            )
        if (dimension := dimensions[name]) is not None:
            if mapped.offset and unit is None:
                raise DescriptionError(f"{place}: say the unit of the offset, such as [deg] or [mm]")
            per_si(unit, dimension, place, DescriptionError)


def _check_joints(mechanism: Mechanism, instruments: tuple[Instrument, ...], where: str) -> None:
    """Raise `DescriptionError` if an instrument reads a joint that does not move, or in the wrong dimension."""
    moves = np.any(mechanism.select_moving, axis=1)
    moving = [name for name, is_moved in zip(mechanism.origin_names, moves, strict=True) if is_moved]
    for instrument in instruments:
        if not isinstance(instrument, JointInstrument):
            continue
        place = f"{where}: instruments.{instrument.name}.joint"
        require_known(instrument.joint, moving, f"{place}: no moving joint", DescriptionError)
        dimension_read, dimension = instrument.parts[0].dimension, mechanism.dimensions[instrument.joint]
        if dimension_read != dimension:
            how = "slides" if dimension == "length" else "turns"
            raise DescriptionError(f"{place}: joint '{instrument.joint}' {how}; set dimension: {dimension}")
