"""Sizes of the joint errors that curves describe, and where curves hold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray
from calib.core.base.units import Dimension
from calib.core.fitting.fitted import Fit
from calib.core.robots.robot import Robot

BEYOND = 0.02
"""A joint's curve holds beyond each end of the measured range by up to this part of the range."""


@dataclass(frozen=True)
class JointCurve:
    """The error of one joint over its own value, as found.

    Attributes:
        low, high: Ends of the measured range [m or rad].
        rms: Root mean square of the error over the used visits [m or rad].
        rms_std: Root mean square of its standard deviation over the used visits [m or rad].
    """

    joint: str
    dimension: Dimension
    low: float
    high: float
    rms: float
    rms_std: float


def joint_curves(fit: Fit) -> tuple[JointCurve, ...]:
    """Return the curve of each joint term whose coefficients are a family."""
    robot, data, curves = fit.robot, fit.identification.data, []
    for term, own in robot.terms_with_places():
        if not term.parameters[0].family:
            continue
        j, free = robot.joint_names.index(term.joint), np.isin(fit.unknowns.index, np.arange(own.start, own.stop))
        columns, q = term.columns(data.joints, j, data.conditions), data.joints[:, j]
        variance = np.sum((columns @ fit.covariance.values[np.ix_(free, free)]) * columns, axis=1)
        rms = float(np.sqrt(np.mean((columns @ robot.values[own]) ** 2)))
        rms_std = float(np.sqrt(np.mean(np.maximum(variance, 0.0))))
        curves.append(JointCurve(term.joint, robot.mechanism.dimensions[term.joint], q.min(), q.max(), rms, rms_std))
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
