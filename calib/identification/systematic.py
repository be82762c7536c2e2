"""Systematic residuals: patterns that noise does not make.

Question. Would the model explain the data significantly better with one more effect? For an effect with columns Z (what
it would add to the measured rows) the linear model r = J du + Z c is compared with the fit:

    M = I - J A^-1 J^T,   A = J^T J + sigma^2 P        what of Z the fit has not absorbed already
    gain = r^T Z (Z^T M Z)^-1 Z^T r                    by how much |r|^2 would fall
    F = (gain / k) / ((|r|^2 - gain) / (nu - k))       against F(k, nu - k), k columns left after M

Effects tested, all as displacements of the targets through the robot (d(position)/d(joint), loops closed):

    axis         a constant shift along each axis of the measurement frame
    joint        each joint off by a smooth curve of its own value (Legendre polynomials of degree 1 to 3 over the range
                 measured): gear error, lead error, gravity sag
    approach     each joint off by +-b, by the direction in which it moved last: backlash 2b
    drift        a shift that changes smoothly in the course of the measurement: a tracker or a base that moved
    zero         each joint off by an error that changes in the course of the measurement: an encoder or a belt that
                 slipped, warming up

An effect that the fit absorbs (a constant shift, where the base is free) cannot be seen and is not tested, and nothing
is put down to a joint that never moved. A finding needs a chance below 1 % over the number of tests, and an effect of
at least a tenth of the noise: enough data make any trifle significant.

The direction of approach and the course of the measurement come from the order of the rows in the data file, which must
be the order of measurement. A sudden change shows too: a polynomial of degree 3 explains 86 % of a step.

When it fails. Effects in other shapes stay in the noise; two effects that look alike at the poses measured are both
named. F supposes normal noise.

Reference: cook1982, chapter 2.4 (added variables).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pinocchio as pin
from numpy.polynomial import legendre
from scipy.stats import f as f_distribution

from calib.identification.pose_checks import unmoved_joints
from calib.linearisation.jacobian import origin_jacobian
from calib.model.mechanism import FloatArray
from calib.model.robot import Configurations, Robot
from calib.numerics.statistics import EXACT
from calib.units import DISPLAY_UNIT, PER_SI, Dimension

FALSE_ALARM = 0.01
"""Chance that good residuals show a pattern."""
SMALLEST_EFFECT = 0.1
"""Least root mean square of an effect, over that of the noise, that is worth a finding."""
_ABSORBED = 1e-6  # part of an effect's square that must be left after the fit for it to be seen
_DEGREE = 3

Kind = Literal["axis", "joint", "approach", "drift", "zero"]


@dataclass(frozen=True)
class Pattern:
    """One effect that was tested.

    Attributes:
        kind: Which effect.
        name: The axis or joint; `xyz` for a drift.
        p_value: Chance of such a pattern from noise, over all tests.
        size: Root mean square displacement that it explains [m].
        amount: The shift [m], or half the backlash [m or rad]; NaN for a curve.
        significant: Whether it counts as a finding.
    """

    kind: Kind
    name: str
    p_value: float
    size: float
    amount: float
    significant: bool


@dataclass(frozen=True, eq=False)
class Residuals:
    """A finished fit as a linear model.

    Attributes:
        rows: Residuals with the noise of one reading, (n_rows,) [m].
        columns: Scaled Jacobian of the same rows, (n_rows, n_free) [m].
        inverse: R^-1 of `calib.numerics.statistics.prior_shares`, (n_free, n_free).
        freedom: Degrees of freedom.
        sigma: Found noise [m].
    """

    rows: FloatArray
    columns: FloatArray
    inverse: FloatArray
    freedom: float
    sigma: float

    def after_fit(self, effect: FloatArray) -> FloatArray:
        """Return M Z, what a fit leaves of effects Z (n_rows, n_effects) on the residuals, (n_rows, n_effects)."""
        pulled = self.columns @ self.inverse
        result: FloatArray = effect - pulled @ (pulled.T @ effect)
        return result


def joint_jacobian(robot: Robot, configurations: Configurations) -> FloatArray:
    """Return d(position)/d(actuated joint), loops closed, (n_poses, n_targets, 3, n_actuated) [m per m or rad].

    Moving a joint by dq is the same as turning its origin by dq about the joint's own axis.
    """
    mechanism = robot.mechanism
    model = mechanism.model
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    twists = np.zeros((6 * mechanism.n_joints, len(mechanism.actuated)))
    for i in range(mechanism.n_joints):
        axis = np.asarray(data.joints[i + 1].S).reshape(6)
        twists[6 * i : 6 * i + 6] = np.outer(axis, mechanism.select_actuated[i])
    return origin_jacobian(mechanism, configurations, twists)[1]


def patterns(
    residuals: Residuals, robot: Robot, configurations: Configurations, approach: FloatArray, weight: FloatArray
) -> tuple[Pattern, ...]:
    """Test all effects.

    Args:
        residuals: The fit.
        robot: The calibrated robot.
        configurations: Its poses.
        approach: Direction of approach of each joint, (n_poses, n_actuated).
        weight: Root of the weight of each point's rows, (n_poses, n_targets).
    """
    if residuals.sigma < EXACT:
        return ()
    tested: list[tuple[Kind, str, float, float, float]] = []
    for kind, name, effect in _effects(robot, configurations, approach):
        rows = (weight[:, :, None, None] * effect).reshape(len(residuals.rows), -1)
        found = _test(residuals, rows)
        if found is not None:
            tested.append((kind, name, *found))
    result = []
    for kind, name, p_value, size, amount in tested:
        p = min(1.0, p_value * len(tested))
        significant = p < FALSE_ALARM and size > SMALLEST_EFFECT * np.sqrt(3.0) * residuals.sigma
        result.append(Pattern(kind, name, p, size, amount, bool(significant)))
    return tuple(sorted(result, key=lambda pattern: (pattern.p_value, -pattern.size)))


def _effects(
    robot: Robot, configurations: Configurations, approach: FloatArray
) -> Iterator[tuple[Kind, str, FloatArray]]:
    """Yield (kind, name, Z as (n_poses, n_targets, 3, k))."""
    by_joint = joint_jacobian(robot, configurations)
    course = _curves(np.arange(len(by_joint), dtype=float))
    for axis, name in enumerate("xyz"):
        shift = np.zeros((*by_joint.shape[:3], 1))
        shift[:, :, axis] = 1.0
        yield "axis", name, shift
    drift = np.eye(3)[:, :, None] * course[:, None, None, None, :]
    yield "drift", "xyz", np.broadcast_to(drift, (*by_joint.shape[:3], 3, _DEGREE)).reshape(*by_joint.shape[:3], -1)
    still = unmoved_joints(robot, configurations.actuated)
    for j, name in enumerate(robot.joint_names):
        column, q = by_joint[..., j : j + 1], configurations.actuated[:, j]
        if name in still:
            continue
        yield "joint", name, column * _curves(q)[:, None, None, :]
        yield "approach", name, column * approach[:, j][:, None, None, None]
        yield "zero", name, column * course[:, None, None, :]


def _curves(values: FloatArray) -> FloatArray:
    """Legendre polynomials of degree 1 to 3 over the range of some values (n,), (n, 3)."""
    curves: FloatArray = legendre.legvander(2 * (values - values.min()) / np.ptp(values) - 1, _DEGREE)[:, 1:]
    return curves


def _test(residuals: Residuals, effect: FloatArray) -> tuple[float, float, float] | None:
    """Return p value, root mean square displacement explained, and coefficient (one column only); None if unseen."""
    size = np.linalg.norm(effect, axis=0)
    if not np.all(size > 0):
        return None
    unit = effect / size
    values, vectors = np.linalg.eigh(unit.T @ residuals.after_fit(unit))
    seen = values > _ABSORBED
    k = int(np.sum(seen))
    if k == 0 or residuals.freedom - k < 1:
        return None
    score = vectors[:, seen].T @ (unit.T @ residuals.rows)
    gain = float(np.sum(score**2 / values[seen]))
    total = float(residuals.rows @ residuals.rows)
    rest = max(total - gain, 1e-12 * total) / (residuals.freedom - k)
    p_value = float(f_distribution.sf(gain / k / rest, k, residuals.freedom - k))
    amount = float("nan")
    if effect.shape[1] == 1:
        amount = float(score[0] * vectors[0, 0] / values[0] / size[0])
    return p_value, float(np.sqrt(3.0 * gain / len(residuals.rows))), amount


def describe(pattern: Pattern, dimensions: Mapping[str, Dimension]) -> str:
    """Return a pattern in words.

    Args:
        pattern: The pattern.
        dimensions: Whether each joint is a length or an angle.
    """
    size = f"{1e3 * pattern.size:.3g} mm RMS"
    if pattern.kind == "axis":
        return f"a constant shift of {1e3 * pattern.amount:+.3g} mm along {pattern.name}"
    if pattern.kind == "joint":
        return f"an error that follows joint {pattern.name} ({size})"
    if pattern.kind == "drift":
        return f"a shift in the course of the measurement, as of a tracker or base that moved ({size})"
    if pattern.kind == "zero":
        return f"an error of joint {pattern.name} that changes in the course of the measurement ({size})"
    unit = DISPLAY_UNIT[dimensions[pattern.name]]
    amount = 2 * abs(pattern.amount) * PER_SI[dimensions[pattern.name]][unit]
    return f"joint {pattern.name} differs by {amount:.2g} {unit} with the direction of approach ({size})"
