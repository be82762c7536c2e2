"""Facts from which a function computes the tool poses of a robot: trees, joint terms, gravity.

Joint errors are sums of two kinds of terms (`calib.core.robots.terms.formula`), with their coefficients multiplied in
and zero terms left out. Torques of gravity are the nominal robot's, whose tree is therefore a second tree.

The module also has the common parts of files in every language: the header, and the code in `.txt` files.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import FloatArray, ReadOnlyArrays
from calib.core.base.errors import ComputationError, DataError
from calib.core.robots import loops
from calib.core.robots.configurations import solve_configurations
from calib.core.robots.gravity import accelerations, payload_frame, with_masses
from calib.core.robots.joint_errors import driven_by
from calib.core.robots.robot import Robot
from calib.core.robots.terms.formula import Proportional, Source
from calib.core.robots.terms.term import REFERENCE_TEMPERATURE, Context
from calib.exporting.functions.trees import FunctionTree, tree_of

_STARTS = 64
CONDITIONS = {
    "approach": (
        Source.APPROACH,
        0.0,
        "direction in which each joint moved last, +1 or -1, 0 where not known, (..., n_joints)",
    ),
    "time": (Source.TIME, 0.0, "as the measurements counted it [s], (...)"),
    "temperature": (Source.WARMTH, REFERENCE_TEMPERATURE, "[degC], (...)"),
    "load": (Source.TORQUE, 0.0, "mass at the tool that the URDF does not have [kg], (...)"),
}
"""Conditions of commands by the names in functions: the source that needs each, its default value, and its meaning."""
SOURCES = {
    Source.ONE: "one",
    Source.COMMAND: "command",
    Source.APPROACH: "approach",
    Source.TIME: "time",
    Source.WARMTH: "temperature",
    Source.TORQUE: "torque",
}
"""Quantities to which joint errors are proportional, by their names in the code."""


class JointShare(NamedTuple):
    """Error of a driven joint: `rate` times a number x, or x / sqrt(x^2 + knee^2).

    Attributes:
        driven: Index of the driven joint.
        source: The quantity x.
        place: Index of the joint, if x has a value for each.
        knee: The constant under the root; 0: x itself is used.
        rate: The coefficient, with all constants.
    """

    driven: int
    source: Source
    place: int
    knee: float
    rate: float


class Wave(NamedTuple):
    """Error of a driven joint: sum over k of sine_k sin(k base q) + cosine_k cos(k base q), k = 1, 2, ...

    Attributes:
        driven: Index of the driven joint.
        place: Index of the actuated joint with command q.
        base: Phase per unit of q [rad/rad or rad/m].
        sine, cosine: The coefficients, (n_orders,) each [m or rad].
    """

    driven: int
    place: int
    base: float
    sine: FloatArray
    cosine: FloatArray


class Gravity(NamedTuple):
    """Masses and directions from which gravity torques are computed.

    Attributes:
        tree: Tree of the nominal robot; its world is the root link.
        masses: Mass that each joint carries directly, (n_joints,) [kg].
        moments: Mass times centre in the frame behind the joint, (n_joints, 3) [kg m].
        payload: Joint that carries the payload, from 1, and the payload's position behind it, (3,) [m].
        acceleration: Acceleration of gravity, (3,) [m/s^2].
    """

    tree: FunctionTree
    masses: FloatArray
    moments: FloatArray
    payload: tuple[int, FloatArray]
    acceleration: FloatArray


@dataclass(frozen=True, eq=False)
class RobotFacts(ReadOnlyArrays):
    """Numbers of a robot for its function.

    Attributes:
        robot: The robot.
        units: Unit of each actuated joint, `rad` or `m`.
        tree: Tree of the robot; its first frame is the measurement frame, then one for each target.
        shares, waves: Its joint errors.
        gravity: For torques; None if no error depends on them.
        conditions: Default value and meaning of each condition that the joint errors depend on, by name.
        lower, upper: Limits of the actuated joints, (n_actuated,) [m or rad].
        home: Commands of the home configuration, within these limits, (n_actuated,) [m or rad].
        base: Pose of the measurement frame in the root link, (4, 4) [m]; None if joints move it.
    """

    robot: Robot
    units: tuple[str, ...]
    tree: FunctionTree
    shares: tuple[JointShare, ...]
    waves: tuple[Wave, ...]
    gravity: Gravity | None
    conditions: dict[str, tuple[float, str]]
    lower: FloatArray
    upper: FloatArray
    home: FloatArray
    base: FloatArray | None


def facts_of(robot: Robot) -> RobotFacts:
    """Return the facts of a robot with its current values, for functions that can be written.

    Raises:
        ComputationError: No configuration is known at which the loops close.
    """
    mechanism = robot.mechanism
    commands, configurations = _starts(robot)
    frames = [mechanism.targets[0].a, *(target.b for target in mechanism.targets)]
    shares, waves = _errors(robot)
    sources = {share.source for share in shares}
    lower, upper = robot.urdf.limits(mechanism.actuated)
    return RobotFacts(
        robot=robot,
        units=tuple("m" if mechanism.dimensions[name] == "length" else "rad" for name in robot.joint_names),
        tree=tree_of(mechanism, robot.mode, frames, configurations),
        shares=shares,
        waves=waves,
        gravity=_gravity(robot, commands) if Source.TORQUE in sources else None,
        conditions={name: (value, text) for name, (source, value, text) in CONDITIONS.items() if source in sources},
        lower=lower,
        upper=upper,
        home=np.clip(robot.home, lower, upper),
        base=_base(robot),
    )


def _starts(robot: Robot) -> tuple[FloatArray, FloatArray]:
    """Commands (n, n_actuated) over the joint limits, home first, and x of the closed configurations there."""
    commands = robot.home[None]
    if robot.mechanism.loops:
        with suppress(DataError):  # without samples, home is the only start
            commands = np.vstack([commands, robot.sample(_STARTS - 1)])
    closed = robot.close(commands)
    kept = np.flatnonzero(closed.ok)
    if len(kept) == 0:
        raise ComputationError(f"{robot.path}: no pose is known at which the loops close with these values")
    configurations = solve_configurations(robot, commands[kept], closed.select(kept))
    return commands[kept], np.hstack([configurations.actuated, configurations.passive])


def _errors(robot: Robot) -> tuple[tuple[JointShare, ...], tuple[Wave, ...]]:
    """The joint errors, with equal terms of a joint added up."""
    rates: dict[tuple[int, Source, int, float], float] = {}
    series: dict[tuple[int, int, float], dict[int, FloatArray]] = {}
    for term, values in robot.term_values():
        if not term.adds:
            continue
        for driven in driven_by(term, robot.mechanism):
            formula = term.formula(driven)
            assert formula is not None  # else `why_none` has refused the robot
            if isinstance(formula, Proportional):
                key = (driven, formula.source, formula.place, formula.knee)
                rates[key] = rates.get(key, 0.0) + formula.factor * float(values[0])
                continue
            of_orders = series.setdefault((driven, formula.place, formula.base), {})
            for order, pair in zip(formula.orders, values.reshape(-1, 2), strict=True):
                of_orders[order] = of_orders.get(order, np.zeros(2)) + pair
    shares = tuple(JointShare(*key, rate) for key, rate in rates.items() if rate)
    waves = []
    for (driven, place, base), of_orders in series.items():
        used = [order for order, pair in of_orders.items() if np.any(pair)]
        if used:
            table = np.array([of_orders.get(order, np.zeros(2)) for order in range(1, max(used) + 1)])
            waves.append(Wave(driven, place, base, table[:, 0], table[:, 1]))
    return shares, tuple(waves)


def _gravity(robot: Robot, commands: FloatArray) -> Gravity:
    nominal = robot.nominal
    driven = nominal.without_tilts(commands)
    closed = loops.close(nominal, robot.mode, driven)
    starts = np.hstack([driven, closed.passive])[closed.ok]
    masses = with_masses(robot.urdf, nominal)
    bodies = {} if masses is None else {k: body for k, body in enumerate(masses.inertias) if k and body.mass > 0}
    payload = payload_frame(nominal, robot.description.payload)
    tree = tree_of(nominal, robot.mode, [*bodies, payload], starts, from_root=True)
    n_joints = len(tree.joints)
    mass, moment = np.zeros(n_joints + 1), np.zeros((n_joints + 1, 3))
    for frame, body in zip(tree.frames, bodies.values(), strict=False):
        mass[frame.after] += body.mass
        moment[frame.after] += body.mass * (frame.placement[:3, :3] @ body.lever + frame.placement[:3, 3])
    hangs = tree.frames[len(bodies)]
    nowhere, neutral = np.zeros((1, nominal.n_joints)), Context.neutral(1, len(robot.joint_names))
    acceleration, _ = accelerations(robot, nowhere, neutral)
    return Gravity(tree, mass[1:], moment[1:], (hangs.after, hangs.placement[:3, 3]), acceleration[0])


def _base(robot: Robot) -> FloatArray | None:
    mechanism, frame = robot.mechanism, robot.mechanism.targets[0].a
    joints = np.flatnonzero(mechanism.support[frame])
    if np.any(mechanism.select_moving[joints]):
        return None
    pose = pin.SE3.Identity()
    for k in joints.tolist():
        motion = pin.Motion(mechanism.axes[k] * mechanism.constant[k])
        pose = pose * mechanism.model.jointPlacements[k + 1] * pin.exp6(motion)
    return np.array(pose.homogeneous)


def template(name: str) -> str:
    """Return the code of a `.txt` file, which is the same for every robot."""
    return (Path(__file__).parent / f"{name}.txt").read_text(encoding="utf-8")


def header_lines(facts: RobotFacts, lines: Sequence[str], base: str) -> list[str]:
    """Return the header of a file in lines; `base` is the name of the measurement frame's pose in the file."""
    joints = ", ".join(f"{name} [{unit}]" for name, unit in zip(facts.robot.joint_names, facts.units, strict=True))
    text = [f"The robot {facts.robot.name}: poses of its tools from the commands of its joints.", "", *lines]
    tools = ", ".join(f"{k} {name}" for k, name in enumerate(facts.robot.target_names))
    text += ["", f"Commands: {joints}. All units are SI.", f"Tools: {tools}."]
    text.append("Poses of a tool are in the measurement frame, if the calibration places the robot in it.")
    if facts.base is None:
        text.append("Joints move that frame.")
    else:
        text.append(f"{base} is the pose of that frame in the root link; {base} times a pose is in the root link.")
    if facts.tree.closures:
        text.append("Where loops do not close in the assembly mode of home, the numbers are NaN.")
    return [" ".join(line.split()) for line in text]
