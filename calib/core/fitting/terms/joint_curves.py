"""Curves of joint errors with their bands, from the joint terms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, ReadOnlyArrays
from calib.core.base.units import Dimension
from calib.core.fitting.fitted import Fit
from calib.core.robots.robot import Robot
from calib.core.robots.terms.term import Context

_POINTS = 721
BEYOND = 0.02
"""A joint's curve holds beyond each end of the measured range by up to this part of the range."""


@dataclass(frozen=True, eq=False)
class JointCurve(ReadOnlyArrays):
    """The error of one joint over its own value, as found.

    Attributes:
        command: Commanded values over the measured range, (n,) [m or rad].
        error: Actual minus commanded value, by the curve, (n,) [m or rad].
        std: Standard deviation of `error`, (n,) [m or rad].
        rms: Root mean square of the error over the used visits [m or rad].
        rms_std: Root mean square of its standard deviation over the used visits [m or rad].
    """

    joint: str
    dimension: Dimension
    command: FloatArray
    error: FloatArray
    std: FloatArray
    rms: float
    rms_std: float


def joint_curves(fit: Fit) -> tuple[JointCurve, ...]:
    """Return the curve of each joint term whose coefficients are a family."""
    robot, data, curves = fit.robot, fit.identification.data, []
    for term, own in robot.terms_with_places():
        index = np.arange(own.start, own.stop)
        if not term.parameters[0].family:
            continue
        j = robot.joint_names.index(term.joint)
        q = data.joints[:, j]
        grid = np.zeros((_POINTS, len(robot.joint_names)))
        grid[:, j] = np.linspace(q.min(), q.max(), _POINTS)
        free = np.isin(fit.unknowns.index, index)
        covariance = fit.covariance.values[np.ix_(free, free)]
        values = robot.values[index]
        phi = term.columns(grid, j, Context.neutral(_POINTS, len(robot.joint_names)))
        used = term.columns(data.joints, j, data.conditions)
        curves.append(
            JointCurve(
                term.joint,
                robot.mechanism.dimensions[term.joint],
                grid[:, j],
                phi @ values,
                _std(phi, covariance),
                float(np.sqrt(np.mean((used @ values) ** 2))),
                float(np.sqrt(np.mean(_std(used, covariance) ** 2))),
            )
        )
    return tuple(curves)


def is_beyond_learned(robot: Robot, learned: FloatArray, q: FloatArray) -> BoolArray:
    """Return a mask (n, n_actuated) of joint values q outside the range of those from which curves were learned.

    Args:
        robot: The robot; only its joints with curves count.
        learned: Joint values of the fit, (n_used, n_actuated) [m or rad].
        q: Joint values, (n, n_actuated) [m or rad].
    """
    curved = {term.joint for term in robot.terms if term.parameters[0].family}
    low, high = learned.min(axis=0), learned.max(axis=0)
    margin = BEYOND * (high - low)
    outside: BoolArray = (q < low - margin) | (q > high + margin)
    return outside & np.isin(robot.joint_names, list(curved))


def _std(phi: FloatArray, covariance: FloatArray) -> FloatArray:
    return np.sqrt(np.maximum(np.sum((phi @ covariance) * phi, axis=1), 0.0))
