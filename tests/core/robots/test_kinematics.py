"""Sweeps over many configurations against Pinocchio's own kinematics of the whole tree, one pose at a time."""

import numpy as np
import pinocchio as pin
import pytest

import calib
from calib.core.robots import kinematics
from calib.core.robots.jacobian import linearise
from medrue import robot_file
from medrue.workspace import target_workspace
from tests.urdf_trees import described, random_tree

ROUNDING = 1e-13
"""Of coordinates of order one, over some ten frames."""


def medrue(folder):
    robot, q = calib.load(robot_file()), np.array(target_workspace().q)[::40]
    return robot, robot.assemble(q)


def tree(folder):
    """A humanoid's worth of branches, of which one leads to the target."""
    rng = np.random.default_rng(17)
    text, actuated = random_tree(rng, 60)
    (folder / "tree.urdf").write_text(text)
    robot = described(folder / "tree.urdf", actuated, "l0", "l59")
    return robot, robot.assemble(rng.uniform(-1, 1, (5, len(actuated))))


@pytest.fixture(params=[medrue, tree], ids=["MedRUE", "tree"])
def case(request, tmp_path):
    """Mechanism, joint values of its whole tree, and the sweep that positions and their derivatives are made of."""
    robot, there = request.param(tmp_path)
    mechanism = robot.mechanism
    joints = mechanism.all_joints(there.actuated, there.passive)
    pairs = mechanism.targets + mechanism.loops
    return mechanism, joints, pairs, kinematics.sweep(mechanism, joints, pairs)


def test_frames_seen_from_each_other_are_those_of_the_whole_tree(case):
    mechanism, joints, pairs, swept = case
    data = mechanism.model.createData()
    for k, q in enumerate(joints):
        pin.forwardKinematics(mechanism.model, data, q)
        for pair in pairs:
            expected = data.oMi[pair.a].actInv(data.oMi[pair.b]).homogeneous
            assert np.allclose(kinematics.relative_pose(swept, pair)[k], expected, rtol=0, atol=ROUNDING)


def test_twists_in_the_world_serve_every_frame_as_pinocchios_regressor_would(case):
    mechanism, joints, pairs, swept = case
    left = swept.shared.reduced.joints
    before = mechanism.twists_before(np.eye(6 * mechanism.n_joints))[left]  # of every origin twist
    origins, columns = np.nonzero(np.any(before != 0, axis=1))
    of_origins = np.zeros((len(joints), 6, before.shape[2]))
    of_origins[:, :, columns] = kinematics.twists_in_world(swept, origins, before[origins, :, columns])
    data = mechanism.model.createData()
    for k, q in enumerate(joints):
        pin.computeJointJacobians(mechanism.model, data, q)
        for pair in pairs:
            both = [
                pin.computeJointKinematicRegressor(mechanism.model, data, frame, pin.ReferenceFrame.WORLD)
                if frame
                else np.zeros((6, 6 * mechanism.n_joints))
                for frame in (pair.a, pair.b)
            ]
            sign = np.repeat(mechanism.direction_signs(pair), 6)
            assert np.allclose(of_origins[k] * sign, both[1] - both[0], rtol=0, atol=10 * ROUNDING)


def test_joints_of_other_branches_leave_the_model(tmp_path):
    robot, there = tree(tmp_path)
    mechanism = robot.mechanism
    joints = mechanism.all_joints(there.actuated, there.passive)
    swept = kinematics.sweep(mechanism, joints, mechanism.targets)
    on_the_way = np.flatnonzero(mechanism.direction_signs(mechanism.targets[0]))
    assert list(swept.shared.reduced.joints) == list(on_the_way)
    assert len(on_the_way) < mechanism.n_joints / 4
    assert swept.rotation.shape == (len(joints), len(on_the_way) + 1, 3, 3)
    columns = linearise(robot, there).jacobian
    assert np.isfinite(columns).all()
    assert np.count_nonzero(np.any(columns, axis=(0, 1, 2))) == len(robot.parameters)  # free are those on the way


@pytest.mark.parametrize("n", [0, 1, 31, 95, 96, 97, 1000])
def test_chunks_are_all_poses_in_parts_of_about_equal_size(n):
    parts = [range(n)[part] for part in kinematics.chunks(n)]
    assert [k for part in parts for k in part] == list(range(n))
    assert all(len(part) <= 1.5 * kinematics.CHUNK for part in parts)
    assert len(parts) == 0 or min(map(len, parts)) >= max(map(len, parts)) - 1
