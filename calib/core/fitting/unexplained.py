"""Errors of joints that residuals show in addition to noise, and that no parameter describes.

Residuals larger than the noise say that something is left out: gears, play, a bending link. Where the robot will be off
by it at another pose is not known; how much, is. It is stated as an error of each joint that differs at each pose,
so that a position feels it by its lever, in the directions in which joints move it:

    covariance of x(q) = B C B^T + delta^2 sum over joints of (s_j dx/dq_j)(s_j dx/dq_j)^T

with delta in rad, s_j the characteristic length of the robot for a joint that slides and 1 for one that turns. Delta
is the scatter d of the mixed model of all rows and priors (`calib.core.numerics.mixed_model`): the likeliest one. A
test of whether anything is left out would leave out what is too small for it, which still makes intervals too narrow.

Noise that is stated is 1 in whitened rows, and all that residuals have beyond it is delta. Noise that is not stated is
found together with delta. What tells one from the other: joints move the tool far in some directions and hardly in
others, and noise does not know which; readings that repeat a pose share its errors of joints. What rows cannot tell
apart counts as delta, because the noise of readings does not move the tool
(`calib.core.numerics.size_search.scatter_beside_noise`). Where noise is known, that is nothing; where all joints move
all readings alike, as in a gantry, it is most of what residuals have.

Delta is no part of the covariance of parameters: these are found with residuals as large as they are. Of very many
poses, some tell it.

When it fails. A stated noise that is too small counts as an error of the joints. Where noise is not stated, an error of
few joints, as of a coupling, does not look like one of all joints, and most of it counts as noise: of three simulated
arms with couplings, positions were off by 1.8 to 2.7 standard deviations (RMS), of twelve with gears, a sag or gains by
0.85 to 1.35. State the noise, or fit the term. What the parameters took up shows in no residual: at poses unlike those
measured the robot may be further off. Gross errors that a robust loss lets through count, too. Of a robot that its
parameters describe, noise alone makes delta larger than 0 in about half of all fits.

Reference: patterson1971.
"""

from __future__ import annotations

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.numerics.mixed_model import MixedModel
from calib.core.numerics.mixed_rows import MixedRows
from calib.core.numerics.size_search import likeliest_sizes, scatter_beside_noise
from calib.core.rows.rows import Rows

_POSES = 500
"""Number of poses that tell delta."""


def unexplained_joint_error(rows: Rows, by_joint: FloatArray) -> float:
    """Return delta of the module docstring [rad]; 0 where noise explains the residuals.

    Args:
        rows: Whitened by the stated noise alone, with the weights of a robust loss.
        by_joint: Their derivative by the joints, scaled by s_j and whitened, (n_rows, n_joints).
    """
    model = _model(rows, by_joint)
    if not np.any(model.spread > 0.0):
        return 0.0
    return scatter_beside_noise(likeliest_sizes(model))


def _model(rows: Rows, by_joint: FloatArray) -> MixedModel:
    """The model of some poses."""
    layout, pose = rows.layout, rows.layout.pose_of_row
    poses = np.unique(pose)
    use = np.isin(pose, poses[:: -(-len(poses) // _POSES)]) & (layout.group >= 0) & np.any(rows.jacobian != 0.0, axis=1)
    no_family, stated = np.full(rows.jacobian.shape[1], -1), np.array([group.stated for group in layout.groups])
    return MixedModel.from_rows(
        MixedRows.from_linear_problem(rows.take_rows(use), no_family, stated, pose[use], by_joint[use])
    )
