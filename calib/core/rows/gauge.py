"""Parameters that only compensate places of instruments and targets carry no information about the robot.

If the base is unknown, the origin of the first joint and the base can move together without changing a measurement; so
can the last origin and an unknown target. A fit moves whatever the priors let move most cheaply, so that a reflector
2 mm off its stated place leaves some hundredths of a millimetre in the last joint's origin. A correction of the robot
must not include that.

Let r be the change of the readings at many poses, J their derivative by the scaled parameters u = (p - p_nominal) / s,
N the combinations of u that no reading sees (J N = 0), and D the selection of the parameters of the robot itself. The
values along N are free, and chosen as

    u' = u - J^+ r + N z,      z minimises |D (u - J^+ r + N z)|^2

repeatedly until u' no longer changes. The robot is then as near its nominal one as the measurements allow, base and
targets take the rest, and no reading has changed (N alone would ensure that in the first order only).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.threads import one_blas_thread
from calib.core.numerics import linalg
from calib.core.numerics.identifiability import RANK_TOLERANCE, reduce_rows
from calib.core.robots.joint_sampling import joint_samples
from calib.core.robots.robot import Robot
from calib.core.rows.observed import Observed, observe, predict_readings

_POSES = 256
_ROUNDS = 10
_CONVERGED = 1e-6  # largest change of a scaled parameter at the end; the next one is about its square
_AROUND_HOME = 0.5  # motion is analytic: these poses show all that any poses show [rad, or characteristic lengths]


@one_blas_thread
def nearest_to_nominal(robot: Robot) -> Robot:
    """Return a robot with the same readings, its own parameters as near to nominal as these allow.

    A calibrated robot whose base and targets are known comes back unchanged.
    """
    parameters = robot.parameters[: robot.n_origin_parameters]
    free = np.flatnonzero(robot.is_free[: len(parameters)])
    of_robot = np.array([not parameters[k].placement for k in free], dtype=bool)
    if np.all(of_robot):
        return robot
    sigma = robot.parameters.sigma_si[free]
    expected = robot.parameters.expected_si[free]
    q = poses_around_home(robot)
    predicted = predict_readings(robot, robot.assemble(q))  # NaN outside of an image; set to 0 below
    readings = {name: replace(reading, values=np.nan_to_num(reading.values)) for name, reading in predicted.items()}
    before, _ = _stack(observe(robot, robot.assemble(q), readings))
    for _ in range(_ROUNDS):
        now, jacobian = _stack(observe(robot, robot.assemble(q), readings))
        changed = now - before
        seen, unseen = _split_space(jacobian[:, free] * sigma)
        back = -seen @ linalg.lstsq(jacobian[:, free] * sigma @ seen, changed, rcond=None)
        start = (robot.values[free] - expected) / sigma + back
        step = back - unseen @ linalg.lstsq(unseen[of_robot], start[of_robot], rcond=RANK_TOLERANCE)
        values = robot.values.copy()
        values[free] += sigma * step
        robot = robot.with_parameters(values)
        if np.max(np.abs(step), initial=0.0) < _CONVERGED:
            break
    return robot


def _split_space(scaled: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Combinations of the columns that have an effect, and those that vanish, orthonormal, (n_columns, n) each."""
    _, singular, right = linalg.svd(reduce_rows(scaled), full_matrices=True)
    rank = int(np.sum(singular > RANK_TOLERANCE * singular[0]))
    return right[:rank].T, right[rank:].T


def poses_around_home(robot: Robot) -> FloatArray:
    """Return joint values of reachable poses around home, (n, n_actuated) [m or rad]."""
    lower, upper = robot.urdf.limits(robot.joint_names)
    spread = joint_samples(robot.mode, _POSES)[:, : len(robot.home)] - 0.5
    q = np.clip(robot.home + 2 * _AROUND_HOME * robot.mechanism.joint_scale * spread, lower, upper)
    return np.asarray(q[robot.close(q).ok])


def _stack(observed: Mapping[str, Observed]) -> tuple[FloatArray, FloatArray]:
    """Residuals (n_rows,) and Jacobian (n_rows, n_parameters) of all instruments [SI]; 0 where not read."""
    residuals = np.concatenate([block.residuals.ravel() for block in observed.values()])
    jacobian = np.concatenate([block.jacobian.reshape(-1, block.jacobian.shape[2]) for block in observed.values()])
    return np.nan_to_num(residuals), np.nan_to_num(jacobian)
