"""The identification Jacobian against central differences, all parameters and all components of every origin."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import calib
from calib.core.robots.jacobian import linearise, relative_motion, sweeps
from medrue import robot_file
from medrue.closed_form import forward
from medrue.paper_tables import table1
from medrue.workspace import target_workspace


@pytest.fixture(scope="module")
def robot():
    return calib.load(robot_file())


def relative_error(result, expected):
    """Largest difference of a column, relative to that column's largest entry (to 1 mm per unit for zero columns)."""
    scale = np.maximum(np.max(np.abs(expected), axis=(0, 1)), 1e-3)
    return np.max(np.abs(result - expected) / scale)


@pytest.mark.parametrize("values", [table1().nominal, table1().actual], ids=["nominal", "actual"])
def test_all_36_columns_agree_with_differences_of_the_closed_form(robot, values):
    q = target_workspace().q[::6]
    at = robot.with_parameters(values)
    result = linearise(at, at.assemble(q)).jacobian[:, 0]
    step = 1e-6
    expected = np.empty_like(result)
    for k in range(36):
        change = step * np.eye(36)[k]
        expected[:, :, k] = (forward(q, values + change).p_world_tool - forward(q, values - change).p_world_tool) / (
            2 * step
        )
    assert relative_error(result, expected) <= 1e-6


def by_every_origin(robot, configurations):
    """Derivative of the targets by the twists of all origins, (n, n_targets, 3, 6 n_joints)."""
    mechanism = robot.mechanism
    found = [
        relative_motion(mechanism, swept, mechanism.targets, np.eye(6 * mechanism.n_joints), angular=False)
        for _, swept in sweeps(mechanism, configurations, mechanism.targets)
    ]
    return np.concatenate(found)


@pytest.mark.quick(0)
def test_all_six_components_of_every_origin_agree_with_differences(robot):
    """Along a direction in which each of them takes part."""
    q = target_workspace().q[::40]
    at = robot.with_parameters(table1().actual)
    result = by_every_origin(at, at.assemble(q))[:, 0]
    step, rng = 1e-6, np.random.default_rng(2)
    for i, name in enumerate(at.mechanism.origin_names):
        placement = at.mechanism.placement(name)
        direction, sides = rng.uniform(0.5, 1.0, 6) * rng.choice([-1, 1], 6), []
        for sign in (1, -1):
            moved = {name: placement * pin.exp6(sign * step * direction)}
            sides.append(replace(at, mechanism=at.mechanism.with_placements(moved)).positions(q)[:, 0])
        expected = (sides[0] - sides[1]) / (2 * step)
        along = result[:, :, 6 * i : 6 * i + 6] @ direction
        assert relative_error(along[:, :, None], expected[:, :, None]) <= 1e-6, name
