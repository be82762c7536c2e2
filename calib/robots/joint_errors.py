"""From commanded to actual joints: the terms of a robot's joint errors, and the one door through which they enter."""

from __future__ import annotations

import numpy as np

from calib.base.arrays import FloatArray
from calib.base.errors import DescriptionError, InputError, nearest
from calib.base.units import Dimension, quantity
from calib.joint_terms.term import Context, Joint, JointTerm, TermSection
from calib.joint_terms.terms import TERMS
from calib.robots.description import Description
from calib.robots.gravity import check_gravity, gravity_turn
from calib.robots.mechanism import Mechanism
from calib.robots.urdf.text import UrdfJoint, UrdfText


def build_terms(description: Description, urdf: UrdfText, mechanism: Mechanism, where: str) -> tuple[JointTerm, ...]:
    """Build the joint terms of a description.

    Raises:
        DescriptionError: An unknown joint, a sigma of another dimension, an entry that does not fit its joint, a
            payload at a frame that there is not, or that no joint moves, or gravity in a frame or setup that there is
            not.
    """
    check_gravity(description, mechanism, where)
    if description.payload is not None and description.payload not in mechanism.frames:
        name = description.payload
        raise DescriptionError(f"{where}: payload: no link, joint or target '{name}'{nearest(name, mechanism.frames)}")
    if description.payload is not None and not np.any(
        mechanism.support[mechanism.frames[description.payload]] @ mechanism.select_moving
    ):
        raise DescriptionError(f"{where}: payload: no motor moves '{description.payload}'; name a frame that moves")
    joints = {joint.name: joint for joint in urdf.joints}
    terms: list[JointTerm] = []
    for section in description.terms:
        names = mechanism.actuated if section.joint == "all" else (section.joint,)
        for name in names:
            if name not in mechanism.actuated:
                raise DescriptionError(
                    f"{where}: joint term '{section.term}': no actuated joint '{name}'"
                    f"{nearest(name, (*mechanism.actuated, 'all'))}"
                )
            terms.append(_term(section, name, joints[name], mechanism, where))
    return (*terms, *gravity_turn(description, terms, mechanism))


def _term(section: TermSection, name: str, joint: UrdfJoint, mechanism: Mechanism, where: str) -> JointTerm:
    dimension = mechanism.dimensions[name]
    place = f"{where}: joint term '{section.term}' of '{name}'"
    try:
        unit: Dimension = "angle" if TERMS[section.term].tilts else dimension
        sigma = None if section.sigma is None else quantity(section.sigma, unit, f"{place}, sigma")
        if sigma is not None and sigma <= 0:
            raise InputError(f"{place}: sigma must be positive; leave the term out to have none")
        stroke = joint.upper - joint.lower
        if dimension == "length" and np.isfinite(stroke) and stroke > 0:
            section = section.within(float(stroke))
        return TERMS[section.term].of(Joint(name, dimension, mechanism.actuated), section, sigma)
    except (InputError, ValueError) as error:
        text = str(error)
        raise DescriptionError(text if text.startswith(where) else f"{place}: {text}") from None


def driven_by(term: JointTerm, mechanism: Mechanism) -> list[int]:
    """Return of which of the driven joints the errors depend on a term."""
    return [mechanism.driven.index(name) for name in term.moved(mechanism.dimensions)]


def term_columns(
    terms: tuple[JointTerm, ...], mechanism: Mechanism, q: FloatArray, context: Context
) -> tuple[FloatArray, ...]:
    """Return phi of each term for each joint that it moves, (n, n_moved, n_coefficients) each; 0 if it does not add.

    Args:
        terms: The terms.
        mechanism: The robot.
        q: Commands, (n, n_actuated) [m or rad].
        context: Their conditions.
    """
    columns = []
    for term in terms:
        moved = driven_by(term, mechanism)
        if not term.adds or (term.needs_torque and context.torque is None):
            columns.append(np.zeros((len(q), len(moved), len(term.parameters))))
        else:
            columns.append(np.stack([term.columns(q, j, context) for j in moved], axis=1))
    return tuple(columns)


def joint_errors(
    terms: tuple[JointTerm, ...], mechanism: Mechanism, columns: tuple[FloatArray, ...], values: FloatArray, n: int
) -> FloatArray:
    """Return dq of every driven joint, (n, n_driven), from the columns and the coefficients (n_coefficients,)."""
    errors, start = np.zeros((n, len(mechanism.driven))), 0
    for term, phi in zip(terms, columns, strict=True):
        stop = start + len(term.parameters)
        if term.adds:
            errors[:, driven_by(term, mechanism)] += phi @ values[start:stop]
        start = stop
    return errors
