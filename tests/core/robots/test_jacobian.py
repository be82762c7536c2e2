"""The identification Jacobian against central differences: all parameters, all components of every origin, a tree."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from calib.core.robots import kinematics
from calib.core.robots.jacobian import linearise, relative_motion, sweeps
from medrue.closed_form import forward
from medrue.paper_tables import table1
from medrue.workspace import target_workspace
from tests.kind_checks import assert_positions_move_as_differences_say, relative_error
from tests.urdf_trees import described, random_tree


@pytest.mark.parametrize("values", [table1().nominal, table1().actual], ids=["nominal", "actual"])
def test_all_36_columns_agree_with_differences_of_the_closed_form(medrue, values):
    q = target_workspace().q[::6]
    at = medrue.with_parameters(values)
    result = linearise(at, at.assemble(q)).jacobian[:, 0]
    expected = np.empty_like(result)
    for k, change in enumerate(1e-6 * np.eye(36)):
        ends = [forward(q, values + sign * change).p_world_tool for sign in (1, -1)]
        expected[:, :, k] = (ends[0] - ends[1]) / 2e-6
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
def test_all_six_components_of_every_origin_agree_with_differences(medrue):
    """Along a direction in which each of them takes part."""
    q = target_workspace().q[::40]
    at = medrue.with_parameters(table1().actual)
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


def test_joints_of_other_branches_leave_the_model(tmp_path):
    """A humanoid's worth of branches, of which one leads to the target."""
    rng = np.random.default_rng(17)
    text, actuated = random_tree(rng, 60)
    (tmp_path / "tree.urdf").write_text(text)
    robot = described(tmp_path / "tree.urdf", actuated, "l0", "l59")
    q, mechanism = rng.uniform(-1, 1, (5, len(actuated))), robot.mechanism
    joints = mechanism.all_joints(q, np.zeros((5, 0)))
    swept = kinematics.sweep(mechanism, joints, mechanism.targets)
    on_the_way = np.flatnonzero(mechanism.direction_signs(mechanism.targets[0]))
    assert list(swept.shared.reduced.joints) == list(on_the_way)
    assert len(on_the_way) < mechanism.n_joints / 4
    assert swept.rotation.shape == (5, len(on_the_way) + 1, 3, 3)
    columns = assert_positions_move_as_differences_say(robot, q, steps=[1e-5] * len(robot.parameters))
    assert np.count_nonzero(np.any(columns, axis=(0, 1, 2))) == len(robot.parameters)  # free are those on the way


@pytest.mark.parametrize("n", [0, 1, 31, 95, 96, 97, 1000])
def test_chunks_are_all_poses_in_parts_of_about_equal_size(n):
    parts = [range(n)[part] for part in kinematics.chunks(n)]
    assert [k for part in parts for k in part] == list(range(n))
    assert all(len(part) <= 1.5 * kinematics.CHUNK for part in parts)
    assert len(parts) == 0 or min(map(len, parts)) >= max(map(len, parts)) - 1
