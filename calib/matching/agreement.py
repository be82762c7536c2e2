"""Agreement of a fitted robot with a controller: within the digits of a file, and at other poses.

The only noise of printed pairs is rounding of joint values and poses: every number has a uniform error within its last
digit. With L_v the effect of these errors on the whitened rows of pair v, and rows and priors linear,

    e_v = L_v w,   w uniform on (-sqrt 3, sqrt 3)      C = (J^T J + P^T P)^-1
    d = C (J^T e + P^T z)                              error of the parameters, z normal for the priors
    r = e - J d                                        residuals if the model is exact
    r'_v = (1 - J_v C J_v^T)^-1 r_v                    residuals of pair v, predicted by a fit of the others

Many draws of w give the distributions of sum r^2, sum r'^2 and of errors elsewhere, without the approximation of normal
noise. Real residuals far above all draws show that the model lacks something that the controller has.

If they are, hypotheses move joints, dq = phi(q) c, and so the whitened rows by G c:

    gravity     the joint yields under masses at the origins of links: phi is the rate at which each origin rises as
                the joint turns, with z of the root link upwards. The masses need not be known
    coupling    phi is the value of another joint
    gear        gain, phi = q; waves, phi = sin k q, cos k q

Joint origins may change again, by J d, with each hypothesis. The hypothesis with the least information criterion
(n log sum of squares + c log n) is added, as long as it halves the sum of squares, and until rounding explains the
rest. Then the fit is repeated with corrected joint values, because origins that had absorbed these errors are far off.

When it fails. A part of the controller's model that is smaller than rounding stays hidden; the claim has an allowance
for that (`_ALLOWANCE`). Errors that move no joint are not found. Some hypotheses are equivalent at these pairs: gravity
at a joint with a level axis is a harmonic of that joint.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import FloatArray, ReadOnlyArrays
from calib.core.base.errors import CalibrationError
from calib.core.base.words import count_noun, listing
from calib.core.fitting.fitted import Fit
from calib.core.judging.effects import wave_orders
from calib.core.numerics import linalg
from calib.core.robots.jacobian import linearise
from calib.core.robots.joint_sampling import joint_samples
from calib.core.robots.robot import Robot

CONTROLLER = "controller"
"""Name of the instrument for the controller's poses."""
_DRAWS = 600
_BEYOND = 1.1  # residuals are not rounding if they are more than this many times the largest draw
_ALLOWANCE = 1.25  # factor on the claim, for errors below rounding
_POSES = 300  # other poses of the claim
_SURE = 0.99  # part of the draws in which the claim holds
_MOST = 4  # largest number of hypotheses
_HALVED = 0.5  # largest part of the sum of squares that remains after another hypothesis
_ROUNDS = 2  # fits with the joint errors
_MOST_WAVES = 6  # a turn
_SEEN = 1e-6  # least part of a column that joint origins cannot absorb; less counts as zero


@dataclass(frozen=True, eq=False)
class Agreement(ReadOnlyArrays):
    """Agreement of robot and pairs, by the residuals.

    Attributes:
        ratio: Sum of squares over the largest of all draws: at most 1 if rounding explains them.
        relative_distances: Distance of each pair from the prediction of the others, over the largest of all draws,
            (n_pairs,).
        rounding_distance: Distance by which rounding moves a printed position, 95 % of the pairs [m].
        claim: Distance between robot and controller at other poses over the joints' ranges, 95 % of them [m].
        turn_claim: The same for orientations [rad].
        left_out: Distance from the prediction of the others, RMS over the pairs [m].
        rms: Distance at the pairs, RMS [m].
    """

    ratio: float
    relative_distances: FloatArray
    rounding_distance: float
    claim: float
    turn_claim: float
    left_out: float
    rms: float

    @property
    def to_the_digits(self) -> bool:
        """Whether rounding explains the residuals."""
        return self.ratio <= _BEYOND


def agreement(fit: Fit, rounding: FloatArray, seed: int, more: FloatArray | None = None) -> Agreement:
    """Return the comparison of residuals with rounding.

    Args:
        fit: Fit to pairs of the instrument `CONTROLLER`, with the covariance of rounding as noise.
        rounding: L before whitening, (n_pairs, 6, k) [m, rad].
        seed: Seed of the draws.
        more: Further columns of the whitened rows, (6 n_pairs, c); the fit is not repeated.
    """
    rng = np.random.default_rng(seed)
    whitening, n, k = fit.whitening, len(rounding), rounding.shape[2]
    more = np.zeros((6 * n, 0)) if more is None else more
    jacobian, residuals = _rows(fit)
    jacobian = np.hstack([jacobian, more])
    prior = np.pad(fit.rows.prior.rows, ((0, 0), (0, more.shape[1])))
    L = whitening.flatten({CONTROLLER: rounding.copy()}).reshape(n, 6, k)
    w = rng.uniform(-np.sqrt(3.0), np.sqrt(3.0), (_DRAWS, n, k))
    e = np.einsum("vik,dvk->dvi", L, w).reshape(_DRAWS, -1)
    C = linalg.pinv(jacobian.T @ jacobian + prior.T @ prior, rcond=1e-12, hermitian=True)
    d = (e @ jacobian + rng.standard_normal((_DRAWS, len(prior))) @ prior) @ C
    residuals = residuals - jacobian @ (C[:, len(C) - more.shape[1] :] @ (more.T @ residuals))
    all_r = np.vstack([e - d @ jacobian.T, residuals]).reshape(_DRAWS + 1, n, 6)
    blocks = jacobian.reshape(n, 6, -1)
    others = linalg.pinv(np.eye(6) - blocks @ C @ blocks.swapaxes(1, 2), rcond=1e-9)
    predicted = np.einsum("vij,dvj->dvi", others, all_r)  # r' of the module docstring
    lengths = np.linalg.norm(predicted, axis=2)
    sums = np.stack([np.sum(all_r**2, axis=(1, 2)), np.sum(lengths**2, axis=1)])
    whiten = whitening.flatten({CONTROLLER: np.tile(np.eye(6), (n, 1, 1))}).reshape(n, 6, 6)
    left_out = np.linalg.solve(whiten, predicted[-1][..., None])[:, :3, 0]
    moved = np.linalg.norm(np.einsum("vik,dvk->dvi", rounding[:, :3], w), axis=2)
    size = _ALLOWANCE * float(np.sqrt(max(1.0, sums[0, -1] / np.mean(sums[0, :-1]))))
    errors = _error_elsewhere(fit, d[:, : fit.rows.jacobian.shape[1]])
    return Agreement(
        float(np.max(sums[:, -1] / np.max(sums[:, :-1], axis=1))),
        lengths[-1] / np.max(lengths[:-1]),
        float(np.quantile(moved, 0.95)),
        size * errors[0],
        size * errors[1],
        float(np.sqrt(np.mean(np.sum(left_out**2, axis=1)))),
        float(np.sqrt(np.mean(np.sum(fit.residuals[CONTROLLER][:, :3] ** 2, axis=1)))),
    )


def _error_elsewhere(fit: Fit, d: FloatArray) -> tuple[float, float]:
    """Distance [m] and rotation [rad] at 95 % of other poses, in nearly all draws of scaled parameter errors."""
    robot, index, scales = fit.robot, fit.unknowns.index, fit.unknowns.scales
    rows = linearise(robot, robot.assemble(other_poses(robot)), turns=True).jacobian[:, 0][..., index] * scales
    answers = []
    for part in (rows[:, :3], rows[:, 3:]):
        moved = np.sqrt(sum((d @ part[:, axis].T) ** 2 for axis in range(3)))
        answers.append(float(np.quantile(np.quantile(moved, 0.95, axis=1), _SURE)))
    return answers[0], answers[1]


def other_poses(robot: Robot) -> FloatArray:
    """Return poses over the joints' ranges, at most one turn, (n, n_joints) [m or rad]."""
    lower, upper = robot.urdf.limits(robot.joint_names)
    middle = np.where(np.isfinite(lower + upper), (lower + upper) / 2, 0.0)
    half = np.minimum(np.where(np.isfinite(upper - lower), (upper - lower) / 2, np.pi), np.pi)
    q = middle + half * (2 * joint_samples(robot.mode, 2 * _POSES + 1)[1:, : len(lower)] - 1)
    try:
        return q[robot.close(q).ok][:_POSES]
    except CalibrationError:
        return q[:_POSES]


def explanation(
    fit: Fit, again: Callable[[FloatArray], Fit], q: FloatArray, rounding: FloatArray, seed: int
) -> tuple[str, Agreement]:
    """Return the joint errors that explain the residuals, in words (empty for none), and the agreement with them.

    Args:
        fit: Fit of joint origins.
        again: Function that fits with other joint values (n_pairs, n_joints).
        q: Joint values of the pairs, (n_pairs, n_joints).
        rounding, seed: Arguments of `agreement`.
    """
    by_joint = linearise(fit.robot, fit.robot.assemble(q), turns=True, joints=True).joint_derivative
    assert by_joint is not None
    tried = [
        (words, phi, fit.whitening.flatten({CONTROLLER: np.einsum("vij,vjc->vic", by_joint[:, 0], phi)}))
        for words, phi in hypotheses(fit.robot, q)
    ]
    words, phi, added, moved = list[str](), np.zeros((*q.shape, 0)), np.zeros((6 * len(q), 0)), q
    agreed = agreement(fit, rounding, seed)
    while tried and len(words) < _MOST and not agreed.to_the_digits:
        basis = linalg.orth(np.hstack([_rows(fit)[0], added]), _SEEN)
        spans = [_basis_complement(basis, G) for *_, G in tried]
        rest = _rows(fit)[1] - basis @ (basis.T @ _rows(fit)[1])
        left = [rest - span @ (span.T @ rest) for span in spans]
        n_rows, counts = len(rest), [span.shape[1] for span in spans]
        criteria = [n_rows * np.log(r @ r) + c * np.log(n_rows) for r, c in zip(left, counts, strict=True)]
        best = int(np.argmin(criteria))
        if left[best] @ left[best] > _HALVED * (rest @ rest):
            break
        word, more, G = tried.pop(best)
        words, phi, added = [*words, word], np.concatenate([phi, more], axis=2), np.hstack([added, G])
        for _ in range(_ROUNDS):
            J, r = _rows(fit)
            moved = moved - phi @ linalg.lstsq(np.hstack([J, added]), r, _SEEN)[J.shape[1] :]
            fit = again(moved)
        agreed = agreement(fit, rounding, seed, more=added)
    return listing(words, " and "), agreed


def _rows(fit: Fit) -> tuple[FloatArray, FloatArray]:
    """Rows whitened by the rounding, and their residuals; the scale is 1 unless residuals contradict the rounding."""
    scale = fit.whitening.row_scale(fit.scales)
    return fit.rows.jacobian * scale[:, None], fit.rows.residuals * scale


def hypotheses(robot: Robot, q: FloatArray) -> Iterator[tuple[str, FloatArray]]:
    """Yield the possible errors of each joint at joint values q (n_pairs, n_joints): words, and phi of `q.shape`."""
    names = robot.joint_names
    links = sorted({joint.child for joint in robot.urdf.joints if joint.name in names})
    links.append(robot.description.targets[robot.target_names[0]].frame)
    rises = np.stack([robot.jacobian(q, link)[:, 2] for link in links], axis=2)  # rises of the origins of links
    for j, (joint, orders) in enumerate(zip(names, wave_orders(q), strict=True)):
        moves = {f"gravity at {joint}": rises[:, j], f"gain of {joint}": q[:, [j]]}
        moves |= {f"coupling of {joint} by {other}": q[:, [k]] for k, other in enumerate(names) if k != j}
        most = min(orders.stop, _MOST_WAVES + 1) if robot.mechanism.dimensions[joint] == "angle" else 0
        for waves in range(1, most):
            turned = np.stack([np.sin(waves * q[:, j]), np.cos(waves * q[:, j])], axis=1)
            moves[f"gear of {joint} ({count_noun(waves, 'wave')} a turn)"] = turned
        for words, phi in moves.items():
            yield words, np.einsum("j,nc->njc", np.eye(len(names))[j], phi)


def _basis_complement(basis: FloatArray, G: FloatArray) -> FloatArray:
    """Orthonormal basis of the span of G (n_rows, c) outside of a given basis."""
    G = G / np.maximum(np.linalg.norm(G, axis=0), 1e-300)
    left, values, _ = linalg.svd(G - basis @ (basis.T @ G), full_matrices=False)
    return np.asarray(left[:, values > _SEEN])
