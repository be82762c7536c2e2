"""The position error over poses that noise, priors and other uncertain quantities let expect."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray
from calib.core.rows.prediction import root95


@dataclass(frozen=True)
class RootMeanSquare:
    """A root mean square distance over a set of poses, infinite where not known, and its 95 % interval [m]."""

    value: float
    low95: float
    high95: float


def predicted_rms(
    jacobian: FloatArray, covariance: FloatArray, coverage_factor: float, lasting: BoolArray
) -> RootMeanSquare:
    """Return the root mean square distance between true and predicted positions over poses.

    The sum of the squares of all positions is a sum of independent squares, as in `length95`; its weights are the
    eigenvalues of the covariance S of all positions. Errors that last are the same at every pose, the others differ.

    Args:
        jacobian: B of each position, (n_poses, n_targets, 3, n_uncertain).
        covariance: C of the uncertain quantities; those that last and those that change are independent.
        coverage_factor: Half a 95 % interval of one coordinate, in standard deviations.
        lasting: Mask of the quantities that are the same at every pose, (n_uncertain,).
    """
    of_poses = jacobian.reshape(len(jacobian), -1, jacobian.shape[-1])
    same, change = of_poses[..., lasting], of_poses[..., ~lasting]
    known = covariance[np.ix_(lasting, lasting)]
    flat = same.reshape(-1, same.shape[-1])
    product = known @ (flat.T @ flat)
    changing = change @ covariance[np.ix_(~lasting, ~lasting)] @ change.swapaxes(1, 2)
    trace = np.trace(product) + np.trace(changing, axis1=1, axis2=2).sum()
    squares = (
        np.sum(product * product.T)
        + np.sum(changing**2)
        + 2.0 * np.sum(changing * (same @ known @ same.swapaxes(1, 2)))
    )
    n = len(flat) / 3
    mean = np.array(trace / n)
    low, high = root95(mean, np.array(squares / n**2), coverage_factor)
    return RootMeanSquare(float(np.sqrt(np.maximum(mean, 0.0))), float(low), float(high))


@dataclass(frozen=True)
class TaskIndex:
    """Predicted position error over a set of poses, from measurement noise and priors.

    Attributes:
        rms: Root mean square over poses and targets of the predicted distance [m]; infinite where a position depends on
            parameters that nothing determines.
        maximum: Largest predicted distance [m].
        worst_pose: Pose of the largest.
    """

    rms: float
    maximum: float
    worst_pose: int


def task_index(position_errors: FloatArray) -> TaskIndex:
    """Summarise predicted position errors (n_poses, n_targets) [m], from `Information.position_errors`."""
    return TaskIndex(
        float(np.sqrt(np.mean(position_errors**2))),
        float(np.max(position_errors)),
        int(np.argmax(np.max(position_errors, axis=1))),
    )
