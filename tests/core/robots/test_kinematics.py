"""Sweeps over many configurations: only joints on the way to what is seen count, in parts of about equal size."""

import numpy as np
import pytest

from calib.core.robots import kinematics
from tests.kind_checks import assert_positions_move_as_differences_say
from tests.urdf_trees import described, random_tree


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
