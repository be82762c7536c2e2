"""Joint values that were rounded: visible in their digits, and in the scatter of residuals.

Values in steps of s are off by up to s/2, with a standard deviation of s / sqrt(12), if they were rounded; not at all,
if the robot was commanded to round values. Residuals may distinguish these: rounding scatters the target
along the motion of the joints, further where the arm is longer. With A_v the effect of rounding on the rows of visit v
(one column for each joint, each times s / sqrt(12)), Q = diag(A_v A_v^T), and r = M e (e normal noise of variance f^2,
M the remainder after a fit; see `calib.core.judging.residual_patterns`),

    T = r^T Q r        mean f^2 tr(MQ)        variance 2 f^4 tr(MQMQ)

is the score for a variance along Q. Its chance is that of a scaled chi-square of the same mean and variance. The part
of the noise that rounding can make is tr(MQ) / (f^2 tr M); far beyond 1, the values cannot have been rounded.

When it fails. f is found from the same residuals: where rounding scatters all rows alike, T shows nothing.

Reference: satterthwaite1946.
"""

from __future__ import annotations

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray
from calib.core.base.units import DISPLAY_UNIT, PER_SI, Dimension, quantity_text
from calib.core.base.words import listing
from calib.core.fitting.fitted import Fit
from calib.core.judging import findings
from calib.core.numerics.clusters import blocks_of_equal_length
from calib.core.robots.robot import Robot

_STEPS = tuple(round(figure * 10.0**power, 12) for power in range(2, -6, -1) for figure in (5.0, 2.0, 1.0))
_CLOSE = 1e-6  # a value is on the grid if it is off by less than this part of a step
_DIFFERENT = 8  # fewer different values show no steps
_UNITS: dict[Dimension, tuple[str, ...]] = {"angle": ("deg", "rad"), "length": ("mm", "m")}


def rounding(fit: Fit) -> tuple[str, float, float] | None:
    """Return the steps to which joint values seem rounded; None if there are none.

    Returns:
        The steps in words; the part of the noise variance that rounding to them makes; and the chance that residuals
        scatter as much along the joints without rounding.
    """
    robot = fit.nominal
    steps = joint_steps(robot, fit.identification.data.joints)
    if not np.any(steps > 0):
        return None
    sizes = zip(steps.tolist(), (robot.mechanism.dimensions[name] for name in robot.joint_names), strict=True)
    words = dict.fromkeys(quantity_text(step, DISPLAY_UNIT[dimension]) for step, dimension in sizes if step > 0)
    return listing(list(words), " and "), *_score(fit, steps / np.sqrt(12.0))


def joint_steps(robot: Robot, joints: FloatArray) -> FloatArray:
    """Return the step between all values (n, n_actuated) of each joint, (n_actuated,) [m or rad]; 0 for none."""
    dimensions = [robot.mechanism.dimensions[name] for name in robot.joint_names]
    scales = [[PER_SI[dimension][unit] for unit in _UNITS[dimension]] for dimension in dimensions]
    columns = zip(joints.T, scales, strict=True)
    return np.array([max(usual_step(values * scale) / scale for scale in units) for values, units in columns])


def usual_step(numbers: FloatArray) -> float:
    """Return the largest usual step of which all numbers (n,) are multiples; 0 for none, and for few different ones."""
    left = np.array(_STEPS)
    for some in (numbers[:8], numbers):  # the first few decide most
        ratio = some[:, None] / left
        left = left[np.all(np.abs(ratio - np.round(ratio)) < _CLOSE, axis=0)]
        if len(left) == 0:
            return 0.0
    return float(np.max(left)) if len(np.unique(numbers)) >= _DIFFERENT else 0.0


def _score(fit: Fit, scatter: FloatArray) -> tuple[float, float]:
    """Return the part of the noise variance that joints with this scatter (n_actuated,) make, and the chance of T."""
    linear, setting = findings.linear(fit), findings.setting(fit)
    by_joint = setting.joint_columns * scatter
    mean = square = statistic = twice = 0.0
    through = np.zeros((linear.span.shape[1], linear.span.shape[1]))
    for rows in blocks_of_equal_length(setting.visit):  # some visits, (n_visits, n_rows_of_each)
        across = by_joint[rows].transpose(0, 2, 1)
        ap, aa = np.matmul(across, linear.span[rows]), np.matmul(across, across.transpose(0, 2, 1))
        statistic += float(np.sum(np.matmul(across, linear.rows.residuals[rows][:, :, None]) ** 2))
        mean += float(np.einsum("njj->", aa))
        square += float(np.sum(aa**2))
        twice += float(np.sum(np.matmul(ap, ap.transpose(0, 2, 1)) * aa))  # tr(P^T Q Q P)
        flat = ap.reshape(-1, ap.shape[2])
        through += flat.T @ flat  # P^T Q P
    mean -= float(np.trace(through))
    square += -2.0 * twice + float(np.sum(through**2))
    if mean <= 0 or square <= 0:
        return 0.0, 1.0
    variance = linear.square / linear.freedom
    chance = float(scipy.special.chdtrc(mean**2 / square, statistic / variance * mean / square))
    return mean / (variance * (linear.freedom - linear.confirmed)), chance
