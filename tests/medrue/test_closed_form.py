"""The paper's equations: special poses worked out by hand, and the inverse; geometry is in test_medrue_urdf.py."""

import numpy as np
import pytest

from medrue.closed_form import (
    ACTUATED_JOINTS,
    PASSIVE_JOINTS,
    forward,
    singularity_sines,
)
from medrue.closed_form_inverse import WorkingMode, inverse
from medrue.paper_tables import PARAMETERS, table1
from medrue.workspace import HOME, target_workspace

ROUNDING = 1e-13
"""A few hundred units in the last place of 1 m or 1 rad."""

HOME_Q = np.array([[HOME[name] for name in ACTUATED_JOINTS]])


def perturbed_parameters(count, seed):
    """Parameter sets within 2 mm and 1.5 degrees of nominal, `(count, 36)`."""
    draws = np.random.default_rng(seed).uniform(-1.0, 1.0, (count, len(PARAMETERS)))
    return table1().nominal + table1().reach * draws


def nominal_with(**changes):
    """Nominal parameters with some replaced [m, rad]."""
    values = table1().nominal.copy()
    for name, value in changes.items():
        values[PARAMETERS.index(name)] = value
    return values


def test_symmetric_pose_agrees_with_elementary_geometry():
    """Motors mirrored about the middle of A C: E on the mirror axis, its height from Pythagoras."""
    parameters = nominal_with(
        A1y=0.15, A1z=0.0, C1y=-0.15, C1z=0.0, A2y=0.15, A2z=0.0, C2y=-0.15, C2z=0.0,
        xb=0.0, yb=0.0, zb=0.0, xt=0.0, yt=0.0, zt=0.1,
    )  # fmt: skip
    angle = np.radians(60.0)
    closed = forward([[0.2, angle, np.pi - angle, angle, np.pi - angle, 0.0]], parameters)
    half_width = 0.15 + 0.4 * 0.5
    height = 0.4 * np.sqrt(0.75) + np.sqrt(0.52**2 - half_width**2)
    gamma = np.arctan2(np.sqrt(0.52**2 - half_width**2), half_width)
    expected = np.array([0.2, -0.1 * np.sin(gamma), height + 0.1 * np.cos(gamma)])
    assert np.abs(closed.p_world_tool[0] - expected).max() < ROUNDING
    assert np.abs(closed.passive[0, 4:]).max() < ROUNDING


def test_pose_that_cannot_close_is_nan_and_does_not_touch_its_neighbours():
    q = np.vstack([HOME_Q, HOME_Q, HOME_Q])
    q[1, 1:3] = 0.0, np.pi  # elbows 1.1 m apart: the distal links reach 1.04 m
    closed = forward(q, table1().nominal)
    assert closed.closes.tolist() == [True, False, True]
    assert np.isnan(closed.p_world_tool[1]).all()
    assert np.isnan(closed.R_world_tool[1]).all()
    assert np.isnan(closed.passive[1]).all()
    assert np.isnan(singularity_sines(q, table1().nominal)[1, 0]).all()
    assert np.array_equal(closed.passive[0], closed.passive[2])


def test_support_of_no_length_is_nan():
    closed = forward(HOME_Q, nominal_with(d42=-0.05))
    assert not closed.closes[0]
    assert np.isnan(closed.p_world_tool).all()


def test_one_parameter_set_per_pose_equals_pose_by_pose():
    q, parameters = target_workspace().q[:5], perturbed_parameters(5, seed=3)
    together = forward(q, parameters)
    for row in range(5):
        alone = forward(q[row : row + 1], parameters[row])
        assert np.abs(alone.T_world_tool[0] - together.T_world_tool[row]).max() < ROUNDING
        assert np.abs(alone.passive[0] - together.passive[row]).max() < ROUNDING


def test_inverse_undoes_forward_with_any_parameters():
    q, parameters = target_workspace().q, perturbed_parameters(420, seed=4)
    result = inverse(forward(q, parameters).T_world_tool, parameters)
    assert np.abs(result - q).max() < 1e-12  # rounding, grown where the inverse cosine is steep


def test_inverse_finds_every_working_mode():
    """With other elbows the tool still arrives, wherever the assembly mode allows it."""
    poses = target_workspace().T_world_tool
    for signs in ((1, 1, 1, 1), (-1, -1, -1, -1), (1, -1, 1, 1)):
        q = inverse(poses, table1().nominal, WorkingMode(elbow_signs=signs))
        reached = ~np.isnan(q[:, 0])
        assert reached.any()
        closed = forward(q[reached], table1().nominal)
        assert np.abs(closed.T_world_tool - poses[reached]).max() < 1e-12
        assert (np.sign(closed.passive[:, :4]) == signs).all()


def test_inverse_out_of_reach_is_nan():
    poses = target_workspace().T_world_tool[:2].copy()
    poses[1, 1, 3] += 2.0
    q = inverse(poses, table1().nominal)
    assert np.isfinite(q[0]).all()
    assert np.isnan(q[1]).all()


def test_inverse_with_the_support_backwards_is_nan():
    pose = target_workspace().T_world_tool[:1] @ np.diag([-1.0, -1.0, 1.0, 1.0])
    assert np.isnan(inverse(pose, table1().nominal)).all()


def test_sines_are_zero_where_the_distal_links_are_aligned():
    angle = np.arccos((0.52 - np.hypot(0.15, 0.26) / 2.0) / 0.4)  # B and D 1.04 m apart, minus a nanometre
    q = np.array([[0.3, angle + 1e-9, np.pi - angle - 1e-9, *HOME_Q[0, 3:]]])
    sines = singularity_sines(q, table1().nominal)
    assert sines[0, 0, 2] < 1e-3
    assert sines[0, 1, 2] > 0.5


@pytest.mark.parametrize(
    ("q_shape", "parameters_shape"),
    [((6,), (36,)), ((2, 5), (36,)), ((2, 6), (35,)), ((2, 6), (3, 36))],
)
def test_wrong_shapes_are_errors(q_shape, parameters_shape):
    with pytest.raises(ValueError, match="shape"):
        forward(np.zeros(q_shape), np.zeros(parameters_shape))


def test_wrong_shape_of_a_pose_is_an_error():
    with pytest.raises(ValueError, match="expected \\(n, 4, 4\\)"):
        inverse(np.eye(4), table1().nominal)


def test_results_are_read_only_and_named():
    closed = forward(HOME_Q, table1().nominal)
    for name in PASSIVE_JOINTS:
        assert closed.joint(name)[0] == pytest.approx(HOME[name], abs=1e-15)
    with pytest.raises(ValueError):
        closed.p_world_tool[0, 0] = 0.0
