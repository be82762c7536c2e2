"""Intervals of camera, board and lens, with errors of single images and errors that follow the robot's pose.

Estimates are least squares with weights W, x = A^-1 J^T W r with A = J^T W J + P. Residuals have the errors
of `calib.photographs.shared_errors`: of pixels, of the tool at each image, and of the arm, with columns H = G N. So

    cov x = A^-1 (s^2 J^T W W J + sum of s_f^2 J^T W X_f X_f^T W J + P) A^-1

with X_f the columns of shifts of the tool, of turns of the tool, and of errors of the arm. The estimate depends on W
alone; only the intervals contain the errors of the arm. J^T W H is the effect of these errors on camera and board,
whether residuals show them or not. Their size s_a comes from the part of the residuals that follows the pose, together
with the sizes of the tool's errors.

Since the four sizes are estimates, intervals are widened by Student's t with Satterthwaite's degrees of freedom
2 v^2 / (g^T C g), for a variance v with gradient g by the sizes, and C the inverse of their information
(`calib.core.numerics.size_search`).

Meaning. The intervals are of C and M in the real flange and the real base of the robot. Residuals alone would only give
the C and M that fit best to its nominal poses.

When it fails. The intervals are wrong for an arm of another kind, for poses in another frame than its base, and for
errors that grow with the load or come from the gear of one joint.

Errors of the arm. Errors of lengths and angles move an arm in the same way at similar poses. The part of this motion
that is common to all images is absorbed by camera and board and leaves no residual: an error of the last link's length
moves the camera on it. The other part shows in residuals. It gives the size of the errors, and hence the uncertainty of
camera and board from the hidden part. This needs the motion of the tool by each error at each pose. Joint values would
give it; poses of the tool do not.

Model. The poses are assumed to be those of a typical arm. Its first axis is upright through the origin of the base.
Shoulder and elbow turn about level axes at right angles to the plane of the arm. Both links are 5/8 of the largest
reach, and the elbow is up. The three axes of the wrist meet in the tool, the last along its z. Each of six joints
has two angles and two lengths with errors (Denavit and Hartenberg): about and along its own axis, and about and along
the common normal with the next axis. An error d of an angle about a line through c with direction a, or of a length
along it, moves the tool at p by

    d (a x (p - c), a)    and    d (a, 0)

(translation, rotation), here in the axes of the tool. If all 24 errors are independent with one size t, in m and rad,
their covariance is t^2 sum of N N^T, with N the motion by one error.

Why. The alternative is a smooth random function of the pose. Its correlation length would decide how much stays
hidden: from half to three times the true spread. With the arm above, intervals are nearly those with the true arm.

When it fails. Poses in a frame far from the robot's base have other levers. Where the wrist is straight or the tool is
above the base, joints of this arm turn by much, and those of the real arm may not.

Reference: satterthwaite1946.
"""

from __future__ import annotations

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.numerics.mixed_model import SolvedModel
from calib.core.numerics.size_search import information_by_size
from calib.photographs.shared_errors import EXPECTED, ErrorSizes, ImageRows

_LINK = 5 / 8  # length of a link, over the largest reach
_MANY = 1e6  # degrees of freedom of a known size


def arm_twists(tool: FloatArray) -> FloatArray:
    """Return the motion of the tool, in its axes, by 24 errors of the arm, (n, 6, 24), at poses (n, 4, 4) [m]."""
    p, axes, o = tool[:, :3, 3], tool[:, :3, :3], np.zeros((len(tool), 3))
    upright = np.tile([0.0, 0.0, 1.0], (len(tool), 1))
    level = _unit(np.cross(upright, p))
    reach = np.linalg.norm(p, axis=1, keepdims=True)
    height = np.sqrt((_LINK * np.max(reach)) ** 2 - reach**2 / 4)
    elbow = p / 2 + height * _unit(np.cross(p, level))
    forearm, last = _unit(p - elbow), axes[:, :, 2]
    bend = _unit(np.cross(forearm, last))
    lines = [
        (upright, o), (level, o), (level, elbow), (forearm, p), (bend, p), (last, p),
        (np.cross(level, upright), o), (_unit(elbow), o), (np.cross(forearm, level), elbow),
        (np.cross(bend, forearm), p), (np.cross(bend, last), p), (axes[:, :, 0], p),
    ]  # fmt: skip
    turned = [np.stack([np.cross(along, p - through), along], axis=1) for along, through in lines]
    moved = [np.stack([along, o], axis=1) for along, _ in lines]
    in_base = np.stack(turned + moved, axis=3)  # (n, 2, 3, 24)
    return np.einsum("nba,nkbc->nkac", axes, in_base).reshape(len(tool), 6, -1)


def _unit(vectors: FloatArray) -> FloatArray:
    """Unit vectors; zero for zero vectors."""
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > 1e-9)


def intervals(
    rows: ImageRows, twists: FloatArray, weights: ErrorSizes, at: SolvedModel
) -> tuple[FloatArray, FloatArray]:
    """Return the covariance of the scaled unknowns (k, k), and their degrees of freedom (k,).

    `twists` are motions of the tool by each error of the arm, (n, 6, 24), and `at` has the sizes of all errors.
    """
    model = rows.weigh(weights)
    weighed, levers = rows.whiten(weights, model.jacobian, rows.levers)
    pulls = np.zeros((len(twists), model.jacobian.shape[1], 6))  # J^T W G of each image
    np.add.at(pulls, rows.image, model.jacobian[:, :, None] * levers[:, None])
    tool = EXPECTED * pulls.transpose(1, 0, 2)
    by_size = [tool[:, :, :3], tool[:, :, 3:], EXPECTED * np.sum(pulls @ twists, axis=0), weighed.T]
    inverse, sizes = model.posterior_information.covariance, np.exp(at.logs)
    moved = [inverse @ part.reshape(len(inverse), -1) for part in by_size]  # by errors of size 1
    known = inverse[:, model.prior.has]
    covariance = known @ known.T + sum(size**2 * part @ part.T for size, part in zip(sizes, moved, strict=True))
    slopes = 2 * sizes[:, None] * np.array([np.sum(part**2, axis=1) for part in moved])
    variance = np.sum(slopes * np.linalg.solve(information_by_size(at), slopes), axis=0)
    return covariance, np.clip(2 * np.diag(covariance) ** 2 / variance, 1.0, _MANY)
