"""Joint errors that a controller has in addition to joint origins, from the residuals of a fit.

Each hypothesis moves joints, dq = phi(q) c, and so the whitened rows by G c:

    gravity     the joint yields under masses at the origins of links: phi is the rate at which each origin rises as
                the joint turns, with z of the root link upwards. The masses need not be known
    coupling    phi is the value of another joint
    gear        gain, phi = q; waves, phi = sin k q, cos k q

J are the rows of the fit; joint origins may change again, by J d, with each hypothesis. The hypothesis with the least
information criterion (n log sum of squares + c log n) is added, as long as it halves the sum of squares, and until
rounding explains the rest. Then the fit is repeated with corrected joint values, because origins that had absorbed
these errors are far off.

When it fails. Errors that move no joint are not found. Some hypotheses are equivalent at these pairs: gravity at a
joint with a level axis is a harmonic of that joint.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.words import count_noun, listing
from calib.core.fitting.fitted import Fit
from calib.core.judging.effects import wave_orders
from calib.core.numerics import linalg
from calib.core.robots.jacobian import linearise
from calib.core.robots.robot import Robot
from calib.matching.agreement import Agreement, agreement

_MOST = 4  # largest number of hypotheses
_HALVED = 0.5  # largest part of the sum of squares that remains after another hypothesis
_ROUNDS = 2  # fits with the joint errors
_MOST_WAVES = 6  # a turn
_SEEN = 1e-6  # least part of a column that joint origins cannot absorb; less counts as zero


def explanation(
    fit: Fit, again: Callable[[FloatArray], Fit], q: FloatArray, name: str, rounding: FloatArray, seed: int
) -> tuple[str, Agreement]:
    """Return the joint errors that explain the residuals, in words (empty for none), and the agreement with them.

    Args:
        fit: Fit of joint origins.
        again: Function that fits with other joint values (n_pairs, n_joints).
        q: Joint values of the pairs, (n_pairs, n_joints).
        name, rounding, seed: Arguments of `calib.matching.agreement.agreement`.
    """
    by_joint = linearise(fit.robot, fit.robot.assemble(q), turns=True, joints=True).joint_derivative
    assert by_joint is not None
    tried = [
        (words, phi, fit.whitening.flatten({name: np.einsum("vij,vjc->vic", by_joint[:, 0], phi)}))
        for words, phi in hypotheses(fit.robot, q)
    ]
    words, phi, added, moved = list[str](), np.zeros((*q.shape, 0)), np.zeros((6 * len(q), 0)), q
    agreed = agreement(fit, name, rounding, seed)
    while tried and len(words) < _MOST and not agreed.to_the_digits:
        basis = linalg.orth(np.hstack([_rows(fit)[0], added]), _SEEN)
        spans = [_basis_complement(basis, G) for *_, G in tried]
        rest = _rows(fit)[1] - basis @ (basis.T @ _rows(fit)[1])
        left = [rest - span @ (span.T @ rest) for span in spans]
        best = int(np.argmin([_criterion(rows, span.shape[1]) for rows, span in zip(left, spans, strict=True)]))
        if left[best] @ left[best] > _HALVED * (rest @ rest):
            break
        word, more, G = tried.pop(best)
        words, phi, added = [*words, word], np.concatenate([phi, more], axis=2), np.hstack([added, G])
        for _ in range(_ROUNDS):
            J, r = _rows(fit)
            moved = moved - phi @ linalg.lstsq(np.hstack([J, added]), r, _SEEN)[J.shape[1] :]
            fit = again(moved)
        agreed = agreement(fit, name, rounding, seed, more=added)
    return listing(words, " and "), agreed


def _rows(fit: Fit) -> tuple[FloatArray, FloatArray]:
    """Rows whitened by the rounding, and their residuals."""
    scale = fit.whitening.row_scale(fit.scales)
    return fit.rows.jacobian * scale[:, None], fit.rows.residuals * scale


def hypotheses(robot: Robot, q: FloatArray) -> Iterator[tuple[str, FloatArray]]:
    """Yield the possible errors of each joint at joint values q (n_pairs, n_joints): words, and phi of `q.shape`."""
    names = robot.joint_names
    rises = np.stack([robot.jacobian(q, link)[:, 2] for link in _links(robot)], axis=2)  # rises of the origins of links
    for j, joint in enumerate(names):
        moves = {f"gravity at {joint}": rises[:, j], f"gain of {joint}": q[:, [j]]}
        moves |= {f"coupling of {joint} by {other}": q[:, [k]] for k, other in enumerate(names) if k != j}
        most = min(wave_orders(q[:, j]).stop, _MOST_WAVES + 1) if robot.mechanism.dimensions[joint] == "angle" else 0
        for waves in range(1, most):
            turned = np.stack([np.sin(waves * q[:, j]), np.cos(waves * q[:, j])], axis=1)
            moves[f"gear of {joint} ({count_noun(waves, 'wave')} a turn)"] = turned
        for words, phi in moves.items():
            yield words, np.einsum("j,nc->njc", np.eye(len(names))[j], phi)


def _links(robot: Robot) -> list[str]:
    moved = {joint.child for joint in robot.urdf.joints if joint.name in robot.joint_names}
    return [*sorted(moved), robot.description.targets[robot.target_names[0]].frame]


def _basis_complement(basis: FloatArray, G: FloatArray) -> FloatArray:
    """Orthonormal basis of the span of G (n_rows, c) outside of a given basis."""
    G = G / np.maximum(np.linalg.norm(G, axis=0), 1e-300)
    left, values, _ = linalg.svd(G - basis @ (basis.T @ G), full_matrices=False)
    return np.asarray(left[:, values > _SEEN])


def _criterion(rest: FloatArray, coefficients: int) -> float:
    return float(len(rest) * np.log(rest @ rest) + coefficients * np.log(len(rest)))
