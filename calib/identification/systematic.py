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
from functools import cached_property
from typing import Literal

import numpy as np
import scipy
from numpy.polynomial import legendre

from calib.arrays import FloatArray
from calib.data.measurements import Measurements
from calib.identification.pose_checks import unmoved_joints
from calib.linearisation.observed import Observed
from calib.linearisation.rows import Rows, Scales
from calib.linearisation.whitening import Whitening
from calib.model.robot import Robot
from calib.numerics.variance_components import EXACT, SharedError
from calib.observation.kind import Instrument
from calib.units import DISPLAY_UNIT, ERROR_UNIT, PER_SI, Dimension, error_scale, millimetres

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
        size: Root mean square of what it explains [m]; of readings in another unit where no positions are [SI].
        amount: The shift [m], or half the backlash [m or rad]; NaN for a curve.
        significant: Whether it counts as a finding.
        dimension: What `size` measures.
    """

    kind: Kind
    name: str
    p_value: float
    size: float
    amount: float
    significant: bool
    dimension: Dimension = "length"


@dataclass(frozen=True, eq=False)
class Residuals:
    """A finished fit as a linear model.

    Attributes:
        rows: Its whitened rows, with the weights of a robust loss.
        root: T of `calib.numerics.observability`, (n_free, rank).
        freedom: Degrees of freedom.
        factor: Found over assumed noise.
    """

    rows: Rows
    root: FloatArray
    freedom: float
    factor: float

    def after_fit(self, effect: FloatArray) -> FloatArray:
        """Return M Z, what a fit leaves of effects Z (n_rows, n_effects) on the residuals, (n_rows, n_effects)."""
        pulled = self.rows.jacobian @ self.root
        result: FloatArray = effect - pulled @ (pulled.T @ effect)
        return result


@dataclass(frozen=True, eq=False)
class Setting:
    """What effects are made of.

    Attributes:
        robot: The calibrated robot.
        data: Its measurements.
        observed: These compared with the robot, with derivatives by the joints.
        whitening: What whitened the rows.
        scales: What was assumed of the noise.
        weights: Of each reading, (n_readings,).
    """

    robot: Robot
    data: Measurements
    observed: Mapping[str, Observed]
    whitening: Whitening
    scales: Scales
    weights: FloatArray

    def whitened(self, arrays: Mapping[str, FloatArray]) -> FloatArray:
        """Return what effects do to the rows of each instrument, (n, n_rows, k) [SI], as whitened rows, (n_all, k)."""
        rows: FloatArray = self.whitening.flatten(arrays) / self.whitening.row_scale(self.scales.own)[:, None]
        if self.shared is not None:
            rows = self.shared.whiten(rows)
        return np.sqrt(self.weights)[self.whitening.layout.reading][:, None] * rows

    @cached_property
    def shared(self) -> SharedError | None:
        """What whitens for an error shared by visits; None without one."""
        if not self.scales.shares:
            return None
        return self.whitening.shared_error(self.observed, self.scales.own, self.scales.shared)

    def per_visit(self, values: FloatArray) -> FloatArray:
        """Return values of the visits, (n_visits, ...), for each row."""
        layout = self.whitening.layout
        result: FloatArray = values[layout.visit[layout.reading]]
        return result

    @property
    def metre(self) -> float:
        """What a whitened row of a position is in metres; of the first kind of rows where no positions are."""
        return float(self.scales.own[self._first] * self.whitening.groups[self._first].typical)

    @property
    def dimension(self) -> Dimension:
        """What `metre` measures."""
        return self.whitening.groups[self._first].dimension

    @property
    def _first(self) -> int:
        return next((g for g, group in enumerate(self.whitening.groups) if group.part == "position"), 0)


def patterns(residuals: Residuals, setting: Setting) -> tuple[Pattern, ...]:
    """Test all effects.

    Args:
        residuals: The fit.
        setting: What effects are made of.
    """
    if residuals.factor * setting.metre < EXACT:
        return ()
    tested: list[tuple[Kind, str, float, float, float]] = []
    for kind, name, effect in _effects(setting):
        outcome = _test(residuals, effect)
        if outcome is not None:
            tested.append((kind, name, *outcome))
    result = []
    for kind, name, p_value, size, amount in tested:
        p = min(1.0, p_value * len(tested))
        significant = p < FALSE_ALARM and size > SMALLEST_EFFECT * np.sqrt(3.0) * residuals.factor
        result.append(Pattern(kind, name, p, size * setting.metre, amount, bool(significant), setting.dimension))
    return tuple(sorted(result, key=lambda pattern: (pattern.p_value, -pattern.size)))


def _effects(setting: Setting) -> Iterator[tuple[Kind, str, FloatArray]]:
    """Yield (kind, name, Z as whitened rows (n_rows, k))."""
    robot, data = setting.robot, setting.data
    by_joint = setting.whitened({name: observed.by_joint for name, observed in setting.observed.items()})
    course = _curves(np.arange(len(data), dtype=float))
    shifts = setting.whitened({name: _shift(robot.instrument(name), len(r)) for name, r in data.readings.items()})
    for axis, name in enumerate("xyz"):
        yield "axis", name, shifts[:, axis : axis + 1]
    in_course = setting.per_visit(course)
    yield "drift", "xyz", (shifts[:, :, None] * in_course[:, None, :]).reshape(len(shifts), -1)
    still = unmoved_joints(robot, data.joints)
    for j, name in enumerate(robot.joint_names):
        column, q = by_joint[:, j : j + 1], data.joints[:, j]
        if name in still:
            continue
        yield "joint", name, column * setting.per_visit(_curves(q))
        yield "approach", name, column * setting.per_visit(data.approach_directions[:, j])[:, None]
        yield "zero", name, column * in_course


def _shift(one: Instrument, n: int) -> FloatArray:
    """What shifts of the measurement frame along x, y and z do to n readings, (n, n_rows, 3)."""
    result: FloatArray = np.zeros((n, one.n_rows, 3))
    rows = [k for k, part in enumerate(one.part_of_row) if one.parts[part].name == "position"]
    if len(rows) == 3:
        result[:, rows] = np.eye(3)
    return result


def _curves(values: FloatArray) -> FloatArray:
    """Legendre polynomials of degree 1 to 3 over the range of some values (n,), (n, 3)."""
    curves: FloatArray = legendre.legvander(2 * (values - values.min()) / np.ptp(values) - 1, _DEGREE)[:, 1:]
    return curves


def _test(residuals: Residuals, effect: FloatArray) -> tuple[float, float, float] | None:
    """Return p value, size and coefficient (of one column only) of an effect; None if it cannot be seen.

    The size is the root mean square of what it explains of a point's three rows.
    """
    size = np.linalg.norm(effect, axis=0)
    if not np.all(size > 0):
        return None
    unit = effect / size
    values, vectors = np.linalg.eigh(unit.T @ residuals.after_fit(unit))
    determined = values > _ABSORBED
    k = int(np.sum(determined))
    if k == 0 or residuals.freedom - k < 1:
        return None
    residual = residuals.rows.residuals
    score = vectors[:, determined].T @ (unit.T @ residual)
    gain = float(np.sum(score**2 / values[determined]))
    total = float(residual @ residual)
    rest = max(total - gain, 1e-12 * total) / (residuals.freedom - k)
    p_value = float(scipy.special.fdtrc(k, residuals.freedom - k, max(gain / k / rest, 0.0)))
    amount = float("nan")
    if effect.shape[1] == 1:
        amount = float(score[0] * vectors[0, 0] / values[0] / size[0])
    return p_value, float(np.sqrt(3.0 * gain / residuals.rows.layout.n_read)), amount


def describe(pattern: Pattern, dimensions: Mapping[str, Dimension]) -> str:
    """Return a pattern in words.

    Args:
        pattern: The pattern.
        dimensions: Whether each joint is a length or an angle.
    """
    size = f"{error_scale(pattern.dimension) * pattern.size:.3g} {ERROR_UNIT[pattern.dimension]} RMS"
    if pattern.kind == "axis":
        return f"a constant shift of {millimetres(pattern.amount):+.3g} mm along {pattern.name}"
    if pattern.kind == "joint":
        return f"an error that follows joint {pattern.name} ({size})"
    if pattern.kind == "drift":
        return f"a shift in the course of the measurement, as of a tracker or base that moved ({size})"
    if pattern.kind == "zero":
        return f"an error of joint {pattern.name} that changes in the course of the measurement ({size})"
    unit = DISPLAY_UNIT[dimensions[pattern.name]]
    amount = 2 * abs(pattern.amount) * PER_SI[dimensions[pattern.name]][unit]
    return f"joint {pattern.name} differs by {amount:.2g} {unit} with the direction of approach ({size})"
