"""What tests of kinds of measurement share: derivatives by differences, and a ball that is brought somewhere."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.core.instruments.position import Position
from calib.core.robots.jacobian import linearise
from calib.core.rows.observed import observe, predict_readings

_STEP = 1e-4
_DIFFERENCES = {-2: 1 / 12, -1: -2 / 3, 1: 2 / 3, 2: -1 / 12}
"""Central differences of fourth order."""
_TOGETHER = 5
"""Parameters, drawn by lot, that are moved at once: no error of one is that of others with the opposite sign."""


def relative_error(computed, expected):
    """Largest difference of a column, relative to that column's largest entry (to 1e-3 for zero columns)."""
    scale = np.maximum(np.max(np.abs(expected), axis=(0, 1)), 1e-3)
    return float(np.max(np.abs(computed - expected) / scale))


def kind_error(instrument, view, unknowns, readings):
    """Relative error of `by_twist` and `by_unknown` of one instrument, by moving the frame b and the unknowns."""
    comparison = instrument.compare(view, unknowns, readings)
    columns = []
    for component in range(6):
        column = 0.0
        for k, weight in _DIFFERENCES.items():
            xi = k * _STEP * np.eye(6)[component]
            moved = replace(
                view,
                translation=view.translation + xi[:3],
                rotation=Rotation.from_rotvec(xi[3:]).as_matrix() @ view.rotation,
            )
            column = column + weight / _STEP * instrument.compare(moved, unknowns, readings).residuals
        columns.append(column)
    error = relative_error(comparison.by_twist, np.stack(columns, axis=2))
    for component in range(len(unknowns)):
        column = 0.0
        for k, weight in _DIFFERENCES.items():
            there = unknowns + k * _STEP * np.eye(len(unknowns))[component]
            column = column + weight / _STEP * instrument.compare(view, there, readings).residuals
        error = max(error, relative_error(comparison.by_unknown[:, :, [component]], column[:, :, None]))
    return error


def chain_error(robot, q, readings):
    """Relative error of the derivative of all readings by all parameters, loops closed again for every difference."""
    observed = observe(robot, robot.assemble(q), readings)
    worst, n = 0.0, len(robot.values)
    for some in np.array_split(np.random.default_rng(0).permutation(n), -(-n // _TOGETHER)):
        direction, columns = np.isin(np.arange(n), some).astype(float), dict.fromkeys(readings, 0.0)
        for step, weight in _DIFFERENCES.items():
            moved = robot.with_parameters(robot.values + step * _STEP * direction)
            for name, there in observe(moved, moved.assemble(q), readings).items():
                columns[name] = columns[name] + weight / _STEP * there.residuals
        for name, column in columns.items():
            error = relative_error((observed[name].jacobian @ direction)[:, :, None], column[:, :, None])
            assert error <= 1e-6, f"{name}, {[robot.parameters[k].name for k in some]}: {error}"
            worst = max(worst, error)
    return worst


def assert_terms_move_positions_as_differences_say(robot, q, context=None):
    """Derivatives of positions by coefficients of joint terms, to a millionth of the largest; returns the Jacobian."""
    jacobian = linearise(robot, robot.assemble(q, context=context)).jacobian
    for k in range(*robot.coefficients.indices(len(robot.values))):
        change = 1e-5 * (np.arange(len(robot.values)) == k)
        more, less = (robot.with_parameters(robot.values + s * change).positions(q, context) for s in (1, -1))
        difference = (more - less) / 2e-5
        within = 1e-6 * np.abs(difference).max() + 1e-9  # differences lose digits in entries that are small
        assert np.allclose(jacobian[..., k], difference, rtol=0, atol=within), robot.parameters[k].name
    return jacobian


def brought(robot, q, points):
    """Joint values near q (n, k) at which the first target is at points (n, 3) [m]: Newton's method by differences."""
    q = np.array(q, dtype=float)
    width = q.shape[1]
    for _ in range(60):
        sides = robot.positions(np.concatenate([q + sign * 1e-6 * step for step in np.eye(width) for sign in (1, -1)]))
        sides = sides[:, 0].reshape(width, 2, len(q), 3)
        slope = ((sides[:, 0] - sides[:, 1]) / 2e-6).transpose(1, 2, 0)
        miss = points - robot.positions(q)[:, 0]
        step = np.einsum("nij,nj->ni", np.linalg.pinv(slope, rcond=1e-3), miss)
        size = np.linalg.norm(step, axis=1, keepdims=True)
        q = q + step * np.minimum(1.0, 0.3 / np.maximum(size, 1e-12))
        if np.max(np.abs(miss)) < 1e-12:
            break
    return q, np.max(np.abs(miss), axis=1) < 1e-10


def assert_found(robot, truth, within):
    """A robot has these values by name."""
    values = dict(zip((p.name for p in robot.parameters), robot.values, strict=True))
    assert {name: values[name] for name in truth} == pytest.approx(truth, rel=0, abs=within)


def coverage(n, true, fitted):
    """Part of n fits, `fitted(seed)`, whose 95 % interval holds the truth, of each free parameter of the true ones."""
    hits = []
    for seed in range(n):
        fit = fitted(seed)
        chosen = [k for k, name in enumerate(fit.free_names) if name in true]
        missed = fit.robot.values[fit.unknowns.index[chosen]] - [true[fit.free_names[k]] for k in chosen]
        hits.append(np.abs(missed) <= fit.statistics.half_width[chosen])
    return np.mean(hits, axis=0)


def positions_by_joint(robot, q):
    """Derivative of what a robot's instruments of positions read by the joints, (n, n_instruments, 3, n_actuated)."""
    at = robot.assemble(q)
    observed = observe(robot, at, predict_readings(robot, at), joints=True)
    return np.stack(
        [
            observed[instrument.name].joint_derivative
            for instrument in robot.instruments
            if isinstance(instrument, Position)
        ],
        axis=1,
    )
