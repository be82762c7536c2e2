"""Joint terms that measurements can show."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from pydantic import ValidationError

from calib.core.base.errors import DescriptionError
from calib.core.data.measurements import Measurements
from calib.core.fitting.pose_checks import first_unstated_visit, may_be_wrapped, uncounted_turns, unmoved_joints
from calib.core.robots.joint_errors import term_columns
from calib.core.robots.robot import Robot
from calib.core.robots.terms.term import Condition, JointTerm, TermSection
from calib.core.robots.terms.terms import TERMS
from calib.core.rows.prediction import UndecidedTerms

TELLS = 3.0
"""A kind of term is proven by at least this log evidence: odds of 20 to 1 (kass1995)."""
_NO_DIRECTION = "the data do not state the direction of approach (columns approach_JOINT)"
_SAME_TORQUE = 1e-6  # a joint's load is constant if the torque of gravity changes by no more [N m or N]


@dataclass(frozen=True)
class CandidateTerm:
    """A kind of term, for every joint that can show it and does not have it.

    Attributes:
        term: Name of the kind.
        sections: Entries; none where it cannot be tried.
        refusal: Why it is not tried without a request; empty where it is.
    """

    term: str
    sections: tuple[TermSection, ...] = ()
    refusal: str = ""

    def terms_in(self, robot: Robot) -> tuple[JointTerm, ...]:
        """Return the terms of this kind in a robot."""
        joints = [section.joint for section in self.sections]
        return tuple(
            term for term in robot.terms if type(term) is TERMS[self.term] and {"all", term.joint} & set(joints)
        )

    def is_curve_in(self, robot: Robot) -> bool:
        """Whether coefficients of this kind in a robot are families whose sizes a fit finds."""
        return any(p.family for term in self.terms_in(robot) for p in term.parameters)

    def scaled_sections(self, robot: Robot, factors: Mapping[str, float]) -> tuple[TermSection, ...]:
        """Return the entries for the joints of `factors`, with the sigmas in a robot times the factor of each joint."""
        terms = self.terms_in(robot)
        sigma = {t.joint: float(factors[t.joint] * t.parameters[0].sigma_si) for t in terms if t.joint in factors}
        resized: list[TermSection] = []
        for section in self.sections:
            by_joint = {joint: size for joint, size in sigma.items() if section.joint in ("all", joint)}
            if section.joint == "all" and len(set(by_joint.values())) == 1 and all(t.joint in sigma for t in terms):
                by_joint = {"all": next(iter(by_joint.values()))}
            resized += [section.model_copy(update={"joint": joint, "sigma": size}) for joint, size in by_joint.items()]
        return tuple(resized)


@dataclass(frozen=True)
class TermTrial:
    """The trial of one kind of term.

    Attributes:
        term: Name of the kind.
        added: Whether it is fitted.
        evidence: Rise of the log likelihood with it, given all other kinds; NaN where it was not tried.
        size: Size of its coefficients over the usual size, the largest of its joints.
        size95: The 95 % interval of `size`.
        joints: Joints for which it is fitted, where each has its own size.
        refusal: Why the measurements cannot show it, or are too few to fit it; empty where neither holds.
    """

    term: str
    added: bool = False
    evidence: float = float("nan")
    size: float = float("nan")
    size95: tuple[float, float] = (float("nan"), float("nan"))
    joints: tuple[str, ...] = ()
    refusal: str = ""

    @property
    def proven(self) -> bool:
        """Whether the term is significant."""
        return self.added and self.evidence >= TELLS

    @property
    def lacks_measurements(self) -> bool:
        """Whether the measurements show the term, but are too few to fit it."""
        return bool(self.refusal) and math.isfinite(self.size)


@dataclass(frozen=True)
class TermChoice:
    """Joint terms that a fit was to choose from.

    Attributes:
        requested: `auto`, `none`, or the requested list.
        sections: The entries of the fit.
        trials: With `auto`, the result for each kind of term, added ones first.
        undecided: With `auto`, the uncertainty from the sizes of all kinds; None if there is none.
    """

    requested: str
    sections: tuple[TermSection, ...]
    trials: tuple[TermTrial, ...] = ()
    undecided: UndecidedTerms | None = None

    @property
    def automatic(self) -> bool:
        """Whether the data decide which terms the robot has."""
        return self.requested == "auto"


def candidates(robot: Robot, data: Measurements) -> tuple[CandidateTerm, ...]:
    """Return a candidate for each kind of term, in the order of the registry, then remarks on terms that cannot be
    tried.
    """
    kinds = []
    for name in TERMS:
        try:
            if TERMS[name].in_auto:
                kinds.append(_candidate(name, robot, data))
        except DescriptionError as error:  # a broken package of others
            kinds.append(CandidateTerm(name, refusal=str(error)))
    uncounted = uncounted_turns(robot, data.joints)
    if uncounted:
        tried = [kind.term for kind in kinds if kind.sections and TERMS[kind.term].counts_turns]
        kinds += [CandidateTerm(name, refusal=may_be_wrapped(uncounted, [f"a {name}"])) for name in tried]
    return tuple(kinds)


def missing_terms(robot: Robot, sections: tuple[TermSection, ...]) -> tuple[TermSection, ...]:
    """Return entries without those of terms that a robot has already, joint by joint."""
    missing: list[TermSection] = []
    for section in sections:
        kind = TERMS[section.term]
        having = {term.joint for term in robot.terms if type(term) is kind and term.answers(section)}
        joints = robot.joint_names if section.joint == "all" else (section.joint,)
        left = [joint for joint in joints if joint not in having]
        all_miss = len(left) == len(joints)
        missing += [section] if all_miss else [section.model_copy(update={"joint": joint}) for joint in left]
    return tuple(missing)


def _candidate(name: str, robot: Robot, data: Measurements) -> CandidateTerm:
    kind = TERMS[name]
    joints, hidden = _joints_that_show(name, kind, robot, data)
    refused = why_term_unknown(kind, data) or hidden
    if refused:
        return CandidateTerm(name, refusal=refused)
    try:
        entries = kind.entries(name, joints, robot.joint_names)
        sections = missing_terms(robot, entries)
        if not sections:
            return CandidateTerm(
                name, refusal="the description has it already" if entries else "there is no other joint"
            )
        with_it = robot.with_terms((*robot.description.terms, *sections))
        columns = term_columns(with_it, data.joints, data.conditions)
    except ValidationError:
        return CandidateTerm(name, refusal="it needs further values, which only a description can state")
    except DescriptionError as error:  # no masses, a prismatic joint without limits
        return CandidateTerm(name, refusal=str(error).removeprefix(f"{robot.path}: "))
    if kind.needs_torque:
        loaded = [
            term.joint
            for term, torque in zip(with_it.terms, columns, strict=True)
            if type(term) is kind and np.ptp(torque, axis=0).max() > _SAME_TORQUE
        ]
        sections = missing_terms(robot, tuple(kind.section(joint=joint, term=name) for joint in loaded))
        if not sections:
            return CandidateTerm(name, refusal="gravity loads no joint differently from pose to pose")
    doubtful = Condition.APPROACH in kind.depends_on and not data.states_approach
    return CandidateTerm(name, sections, refusal=_NO_DIRECTION if doubtful else "")


def why_term_unknown(kind: type[JointTerm], data: Measurements) -> str:
    """Return why data cannot show a term, by the conditions that it depends on; empty if they can."""
    for condition in kind.depends_on:
        by_torque = condition == Condition.LOAD and kind.needs_torque  # the robot's own masses load it, too
        stated = np.nan_to_num(data.context.get(condition.column, np.zeros(len(data))))
        if condition.column and not by_torque and np.ptp(stated) == 0:
            return f"the data have no column '{condition.column}' that changes"
        if first_unstated_visit(condition, data) is not None:
            return f"some rows do not state {condition.words}"
    return ""


def _joints_that_show(name: str, kind: type[JointTerm], robot: Robot, data: Measurements) -> tuple[list[str], str]:
    """Joints (driving ones, of couplings) that can show a kind of term in these measurements; or why there are none."""
    uncounted = uncounted_turns(robot, data.joints) if kind.counts_turns else []
    unmoved = unmoved_joints(robot, data.joints) if kind.follows_command else []
    needs = {joint: kind.needs_more(robot.mechanism.dimensions[joint]) for joint in robot.joint_names}
    from_one_side: list[str] = []
    if Condition.APPROACH in kind.depends_on:
        same = np.ptp(data.approach_directions, axis=0) == 0
        from_one_side = [joint for joint, is_same in zip(robot.joint_names, same, strict=True) if is_same]
    hidden = {*uncounted, *unmoved, *from_one_side, *(joint for joint, need in needs.items() if need)}
    if hidden < set(needs):
        return [joint for joint in needs if joint not in hidden], ""
    if uncounted:
        return [], may_be_wrapped(uncounted, [f"a {name}"])
    if len(from_one_side) == len(needs):
        return [], "no joint was approached from both sides"
    return [], "no joint moved that could show it" if "" in needs.values() else next(iter(needs.values()))
