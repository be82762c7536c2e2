"""The identification Jacobian: how measured positions move with parameters, through closed loops, exactly.

With passive joints p decided by the closures r(xi, p) = 0, and x the position of a target in the measurement frame:

    dx/dxi = X_xi - W C_xi        W = X_p C_p^-1

(implicit function theorem), where X and C are the derivatives of x and r by origin twists xi and passive joints. W is
found first, so that one small solve per pose serves all origins; then both terms are one sum of twist maps times
Pinocchio's kinematic regressor. Finally d(parameters) enters through the twists of the parametrisation.

Poses are processed in chunks that stay in the processor's cache.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.model import kinematics
from calib.model.mechanism import FloatArray, Mechanism, RelativeFrame
from calib.model.robot import Configurations, Robot
from calib.threads import one_blas_thread

_CHUNK = 64


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Positions and their derivatives.

    Attributes:
        positions: Targets in the measurement frame, (n, n_targets, 3) [m].
        jacobian: d(positions)/d(parameters), (n, n_targets, 3, n_parameters) [m per m or rad].
    """

    positions: FloatArray
    jacobian: FloatArray


def linearise(robot: Robot, configurations: Configurations) -> Linearisation:
    """Positions of all targets and their derivative by every parameter, at the robot's current values.

    Args:
        robot: The robot.
        configurations: Assembled poses, from `robot.assemble`.
    """
    positions, by_origin = origin_jacobian(robot.mechanism, configurations, _parameter_twists(robot))
    return Linearisation(positions, by_origin)


@one_blas_thread
def origin_jacobian(
    mechanism: Mechanism, configurations: Configurations, twists: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Positions of all targets and their derivative by the right-perturbation twist of every origin.

    Args:
        mechanism: The mechanism.
        configurations: Assembled poses.
        twists: If given, (6 n_joints, k), the derivative is taken along these combinations instead.

    Returns:
        Positions (n, n_targets, 3) [m] and derivative (n, n_targets, 3, 6 n_joints or k), origins in the order of
        `mechanism.origin_names`, six components [linear; angular] each, in the joint's own frame.
    """
    n, n_targets = len(configurations.actuated), len(mechanism.targets)
    width = 6 * mechanism.n_joints if twists is None else twists.shape[1]
    positions = np.empty((n, n_targets, 3))
    derivative = np.empty((n, n_targets, 3, width))
    joints = mechanism.all_joints(configurations.actuated, configurations.passive)
    for start in range(0, n, _CHUNK):
        part = slice(start, min(start + _CHUNK, n))
        swept = kinematics.sweep(mechanism, joints[part], mechanism.targets + mechanism.loops, regressors=True)
        for t, target in enumerate(mechanism.targets):
            positions[part, t] = kinematics.value(swept, target)
            mapping = kinematics.twist_map(swept, target)
            terms = [(mapping, mechanism.between(target))]
            terms += _through_loops(mechanism, swept, target, mapping, configurations.slope[part])
            by_origin = kinematics.origin_derivative(mechanism, swept, terms)
            derivative[part, t] = by_origin if twists is None else _times(by_origin, twists)
    return positions, derivative


def _through_loops(
    mechanism: Mechanism,
    swept: kinematics.Sweep,
    target: RelativeFrame,
    mapping: FloatArray,
    slope: FloatArray,
) -> list[tuple[FloatArray, FloatArray]]:
    """The terms -W C_xi, loop by loop."""
    if not mechanism.loops:
        return []
    columns = mechanism.between(target)[:, None] * mechanism.select_passive
    by_passive = kinematics.joint_derivative(swept, mapping, columns)
    weights = np.linalg.solve(slope.transpose(0, 2, 1), by_passive.transpose(0, 2, 1)).transpose(0, 2, 1)
    terms, row = [], 0
    for loop in mechanism.loops:
        part = weights[:, :, row : row + len(loop.rows)]
        terms.append((-np.matmul(part, kinematics.twist_map(swept, loop)), mechanism.between(loop)))
        row += len(loop.rows)
    return terms


def _times(by_origin: FloatArray, twists: FloatArray) -> FloatArray:
    n = len(by_origin)
    result: FloatArray = (by_origin.reshape(3 * n, len(twists)) @ twists).reshape(n, 3, twists.shape[1])
    return result


def _parameter_twists(robot: Robot) -> FloatArray:
    """Twists of all origins per parameter, (6 n_joints, n_parameters)."""
    mechanism = robot.mechanism
    matrix = np.zeros((6 * mechanism.n_joints, len(robot.parameters)))
    for name, twist in robot.parametrisation.twists(robot.values).items():
        row = 6 * mechanism.origin_names.index(name)
        matrix[row : row + 6] = twist
    return matrix
