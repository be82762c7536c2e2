"""From commanded to actual joints: the joint terms of a robot, and the only place where they are added."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import DescriptionError, InputError, require_known
from calib.core.base.units import Dimension, quantity
from calib.core.robots.description import Description
from calib.core.robots.gravity import check_gravity, gravity_torques, gravity_turn, turn_columns
from calib.core.robots.mechanism import Mechanism
from calib.core.robots.mechanism_builder import build_mechanism, tilted_joints
from calib.core.robots.robot_data import RobotData, SomeRobot
from calib.core.robots.terms.term import Context, Joint, JointTerm, TermSection
from calib.core.robots.terms.terms import TERMS
from calib.core.robots.urdf.reader import UrdfJoint
from calib.core.robots.urdf.text import UrdfText


def build_terms(description: Description, urdf: UrdfText, mechanism: Mechanism, where: str) -> tuple[JointTerm, ...]:
    """Build the joint terms of a description.

    `DescriptionError` if an entry, its sigma or its joint is wrong, or a payload, frame or setup does not exist.
    """
    check_gravity(description, mechanism, where)
    if (payload := description.payload) is not None:
        require_known(payload, mechanism.frames, f"{where}: payload: no link, joint or target", DescriptionError)
        if not np.any(mechanism.support[mechanism.frames[payload]] @ mechanism.select_moving):
            raise DescriptionError(f"{where}: payload: no motor moves '{payload}'; name a frame that moves")
    joints = {joint.name: joint for joint in urdf.joints}
    terms: list[JointTerm] = []
    for section in description.terms:
        valid, missing = (*mechanism.actuated, "all"), f"{where}: joint term '{section.term}': no actuated joint"
        require_known(section.joint, valid, missing, DescriptionError)
        for name in mechanism.actuated if section.joint == "all" else (section.joint,):
            terms.append(_term(section, joints[name], mechanism, where))
    return (*terms, *gravity_turn(description, terms, mechanism))


def _term(section: TermSection, joint: UrdfJoint, mechanism: Mechanism, where: str) -> JointTerm:
    kind, name, dimension = TERMS[section.term], joint.name, mechanism.dimensions[joint.name]
    place = f"{where}: joint term '{section.term}' of '{name}'"
    try:
        unit: Dimension = "angle" if kind.tilts else dimension
        sigma = None if section.sigma is None else quantity(section.sigma, unit, f"{place}, sigma")
        if sigma is not None and sigma <= 0:
            raise InputError(f"{place}: sigma must be positive; leave the term out to have none")
        stroke = float(joint.upper - joint.lower)
        if dimension == "length" and 0 < stroke < np.inf:
            section = section.with_stroke(stroke)
        return kind.from_section(Joint(name, dimension, mechanism.actuated), section, sigma)
    except (InputError, ValueError) as error:
        text = str(error)
        raise DescriptionError(text if text.startswith(where) else f"{place}: {text}") from None


def driven_by(term: JointTerm, mechanism: Mechanism) -> list[int]:
    """Return the indices of the driven joints whose errors depend on a term."""
    return [mechanism.driven.index(name) for name in term.driven_joint_names(mechanism.dimensions)]


def columns_of_terms(
    terms: tuple[JointTerm, ...], mechanism: Mechanism, q: FloatArray, context: Context
) -> tuple[FloatArray, ...]:
    """Return phi of each term for each joint that it moves, (n, n_moved, n_coefficients) each, at commands q (n,
    n_actuated).

    Joint errors are phi times the coefficients. phi is 0 for terms that add no errors, or whose torque is missing.
    """
    columns = []
    for term in terms:
        moved = driven_by(term, mechanism)
        if not term.adds or (term.needs_torque and context.torque is None):
            columns.append(np.zeros((len(q), len(moved), len(term.parameters))))
        else:
            columns.append(np.stack([term.columns(q, j, context) for j in moved], axis=1))
    return tuple(columns)


def with_terms(robot: SomeRobot, sections: Sequence[TermSection]) -> SomeRobot:
    """Return a robot with these joint terms in place of its own; see `Robot.with_terms`."""
    description = robot.description.with_terms(sections)
    terms = build_terms(description, robot.urdf, robot.nominal, robot.path)
    changed = replace(robot, description=description, terms=terms, files={})
    if tilted_joints(description) != tilted_joints(robot.description):
        nominal = build_mechanism(robot.urdf, description, robot.instruments, robot.path)
        mechanism = nominal.with_placements(robot.parametrisation.placements(robot.values[: robot.n_origin_parameters]))
        mode = replace(robot.mode, mechanism=nominal, actuated=nominal.without_tilts(robot.home[None])[0])
        changed = replace(changed, nominal=nominal, mechanism=mechanism, mode=mode)
    known = robot.values_by_name
    return replace(changed, values=np.array([known.get(p.name, p.nominal_si) for p in changed.parameters]))


def term_columns(robot: RobotData, q: FloatArray, context: Context | None = None) -> tuple[FloatArray, ...]:
    """Return phi of each joint term (`columns_of_terms`) at commands q (n, n_actuated) [m or rad]."""
    if not robot.terms:
        return ()
    context = Context.neutral(len(q), len(robot.joint_names)) if context is None else context
    if not any(term.needs_torque for term in robot.terms):
        return columns_of_terms(robot.terms, robot.mechanism, q, context)
    torque, slopes = gravity_torques(robot, q, context)
    context = replace(context, torque=torque)
    columns = columns_of_terms(robot.terms, robot.mechanism, q, context)
    return (*columns[:-1], turn_columns(robot, q, context, slopes)) if slopes else columns


def actual_joints(robot: RobotData, q: FloatArray, columns: tuple[FloatArray, ...]) -> FloatArray:
    """Return the driven joints (n, n_driven) at commands q (n, n_actuated) [m or rad]; `columns`: phi of the terms."""
    if not robot.terms:
        return q
    errors = np.zeros((len(q), len(robot.mechanism.driven)))
    for (term, values), phi in zip(robot.term_values(), columns, strict=True):
        if term.adds:
            errors[:, driven_by(term, robot.mechanism)] += phi @ values
    return robot.mechanism.without_tilts(q) + errors
