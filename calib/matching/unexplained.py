"""What a controller computes with beside joint origins, by what the residuals of a fit say.

Each hypothesis moves joints, dq = phi(q) c, and so the whitened rows by G c:

    a joint term    coupling, gear (harmonics), gain, curve of one joint (`calib.core.robots.terms`)
    gravity         one joint gives way to the torque of masses at the origins of links: phi is how fast each of them
                    rises as the joint turns. No masses need be known

With J the rows of the fit and J d taken up by joint origins again, the hypothesis is added that leaves the smallest
mean square by degree of freedom, as long as that halves it, and until rounding explains what is left.

When it fails. What moves no joint; hypotheses that look alike at these pairs: gravity at a joint with a level axis is a
harmonic of that joint.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import CalibrationError
from calib.core.base.words import listed
from calib.core.data.measurements import Measurements
from calib.core.fitting.fitted import Fit
from calib.core.fitting.terms.candidate_terms import candidates
from calib.core.numerics import linalg
from calib.core.robots.joint_errors import driven_by, term_columns
from calib.core.robots.robot import Robot
from calib.core.robots.terms.terms import TERMS
from calib.core.rows.jacobian import linearise
from calib.matching.agreement import Agreement, agreement

_MOST = 4  # hypotheses that are added
_HALVED = 0.5  # part of the mean square that an added one must take away
_SEEN = 1e-6  # part of a column beyond what joint origins take up, below which it is nothing


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """What may move joints: in words, and phi, (n_pairs, n_joints, n_coefficients)."""

    words: str
    phi: FloatArray


def explanation(fit: Fit, data: Measurements, name: str, rounding: FloatArray, seed: int) -> tuple[str, Agreement]:
    """Return what explains residuals, in words (empty for nothing), and what it leaves.

    Args:
        fit: Of joint origins.
        data: The pairs.
        name, rounding, seed: As for `calib.matching.agreement.agreement`.
    """
    by_joint = linearise(fit.robot, fit.robot.assemble(data.joints), turns=True, joints=True).by_joint
    assert by_joint is not None
    scale = fit.whitening.row_scale(fit.scales.groups)[:, None]
    basis, rest = linalg.orth(fit.rows.jacobian * scale, _SEEN), fit.rows.residuals * scale[:, 0]
    rest = rest - basis @ (basis.T @ rest)
    tried = [
        (each.words, fit.whitening.flatten({name: np.einsum("vij,vjc->vic", by_joint[:, 0], each.phi)}))
        for each in hypotheses(fit.robot, data)
    ]
    words, added = list[str](), np.zeros((len(rest), 0))
    agreed = agreement(fit, name, rounding, seed)
    while tried and len(words) < _MOST and not agreed.to_the_digits:
        spans = [_beyond(basis, G) for _, G in tried]
        bases = [np.hstack([basis, span]) for span in spans]
        left = [_per_freedom(rest - span @ (span.T @ rest), wider) for span, wider in zip(spans, bases, strict=True)]
        best = int(np.argmin(left))
        if left[best] > _HALVED * _per_freedom(rest, basis):
            break
        said, G = tried.pop(best)
        basis, rest = bases[best], rest - spans[best] @ (spans[best].T @ rest)
        words, added = [*words, said], np.hstack([added, G])
        agreed = agreement(fit, name, rounding, seed, more=added)
    return listed(words, " and "), agreed


def hypotheses(robot: Robot, data: Measurements) -> Iterator[Hypothesis]:
    """Yield what these pairs can show."""
    names = robot.joint_names
    by_link = [robot.jacobian(data.joints, link)[:, 2] for link in _links(robot)]  # rise of each link's origin
    for j, joint in enumerate(names):
        phi = np.zeros((len(data.joints), len(names), len(by_link)))
        phi[:, j] = np.stack([rise[:, j] for rise in by_link], axis=1)
        yield Hypothesis(f"gravity at {joint}", phi)
    for kind in candidates(robot, data):
        entries = [
            section.model_copy(update={"joint": joint})
            for section in kind.sections
            for joint in (names if section.joint == "all" else (section.joint,))
        ]
        if kind.refused or TERMS[kind.term].needs_torque:
            continue
        with suppress(CalibrationError):
            having = robot.with_terms(entries)
            columns = term_columns(having, data.joints, data.conditions)
            for section, term, column in zip(entries, having.terms, columns, strict=True):
                phi = np.zeros((len(data.joints), len(names), column.shape[2]))
                phi[:, driven_by(term, robot.mechanism)] = column
                by = f" by {section.driven_by}" if hasattr(section, "driven_by") else ""
                yield Hypothesis(f"{kind.term} of {section.joint}{by}", phi)


def _links(robot: Robot) -> list[str]:
    moved = {joint.child for joint in robot.urdf.joints if joint.name in robot.joint_names}
    return [*sorted(moved), robot.description.targets[robot.target_names[0]].frame]


def _beyond(basis: FloatArray, G: FloatArray) -> FloatArray:
    """Orthonormal columns of what G (n_rows, c) spans beyond a basis."""
    G = G / np.maximum(np.linalg.norm(G, axis=0), 1e-300)
    left, values, _ = linalg.svd(G - basis @ (basis.T @ G), full_matrices=False)
    return np.asarray(left[:, values > _SEEN])


def _per_freedom(rest: FloatArray, basis: FloatArray) -> float:
    return float(rest @ rest) / max(basis.shape[0] - basis.shape[1], 1)
