"""Ways to closed configurations: far parameters, single poses, limits of another turn, joints without limits."""

import numpy as np
import pytest

import calib
from calib.core.robots import acceleration, continuation, kinematics
from calib.core.robots.closure import residual
from calib.programs.reaching.goals import Goals
from calib.programs.reaching.inverse import solve
from medrue.closed_form import forward
from medrue.paper_tables import table1
from medrue.workspace import target_workspace
from tests.project import EXAMPLES
from tests.small_robots import edited_five_bar
from tests.urdf_trees import urdf_of

ANGLES = np.array([unit == "rad" for unit in table1().units])


@pytest.mark.quick(0)
def test_every_pose_that_closes_in_the_closed_form_is_found_with_parameters_far_from_nominal(medrue):
    """+-6 mm and +-4.5 deg, where home's loops alone would need corrections above 0.5 rad."""
    rng, q = np.random.default_rng(3), np.array(target_workspace().q)[::30]
    for _ in range(25):
        far = np.where(ANGLES, np.radians(4.5), 6e-3) * rng.uniform(-1, 1, 36)
        oracle = forward(q, table1().nominal + far)
        assert oracle.closes.all()
        positions = medrue.with_parameters(table1().nominal + far).positions(q)[:, 0]
        assert np.max(np.abs(positions - oracle.p_world_tool)) < 1e-10


@pytest.fixture
def five_bar(tmp_path):
    """It, poses of it, and its passive joints there."""
    robot = edited_five_bar(tmp_path)
    q = calib.read_poses(EXAMPLES / "five_bar_simulated.csv", robot).joints
    return robot, q, robot.assemble(q).passive


def test_motor_zeros_that_are_20_degrees_off_leave_the_five_bar_whole(five_bar):
    """Zeros of the motors are an offset of their joint values: the same elbow angles, from other commands."""
    robot, q, expected = five_bar
    zeros = np.radians([20.0, -20.0])
    moved = robot.with_parameters({"left_motor.rz": zeros[0], "right_motor.rz": zeros[1]})
    assert np.max(np.abs(moved.assemble(q - zeros).passive - expected)) < 1e-11


def test_loops_are_open_alike_one_by_one_and_together(medrue):
    mechanism = medrue.mechanism
    q = medrue.home + 0.1 * np.random.default_rng(7).normal(size=(5, 6))
    swept = kinematics.sweep(mechanism, mechanism.all_joints(q, np.tile(medrue.mode.passive, (5, 1))), mechanism.loops)
    for together, alone in ((kinematics.gaps, kinematics.value), (kinematics.gap_maps, kinematics.twist_map)):
        each = np.concatenate([alone(swept, loop) for loop in mechanism.loops], axis=1)
        assert np.abs(each).max() > 1e-3
        assert np.allclose(together(swept), each, rtol=0, atol=1e-14)


@pytest.mark.quick(0)
def test_a_pose_alone_is_found_where_it_is_found_among_others(medrue):
    q = np.random.default_rng(4).uniform(*medrue.joint_limits.T, (120, 6))
    together = medrue.close(q)
    assert 3 < together.ok.sum() < 115
    alone = np.array([medrue.close(row).ok[0] for row in q[together.ok]])
    assert alone.all()


@pytest.mark.quick(0)
def test_steps_tried_together_lead_where_steps_tried_one_after_the_other_lead(medrue, monkeypatch):
    q = np.random.default_rng(6).uniform(-0.4, 0.4, (40, 6)) * medrue.mechanism.joint_scale + medrue.home
    together = medrue.close(q)
    assert 3 < together.ok.sum() < 37
    monkeypatch.setattr(continuation, "_TOGETHER", 1)
    one_by_one = medrue.close(q)
    assert np.array_equal(together.ok, one_by_one.ok)
    assert np.nanmax(np.abs(together.passive - one_by_one.passive)) < 1e-9


@pytest.mark.quick(2)
@pytest.mark.parametrize("part", [1e-3, 1e-2, 0.1, 0.5])
@pytest.mark.parametrize("compiled", [False, True])
def test_a_last_correction_that_is_not_checked_closes_the_loops(medrue, part, compiled):
    if compiled:
        pytest.importorskip("numba", reason="numba is not installed (extra 'fast')")
    q = np.array(target_workspace().q)[::4]
    moved = medrue.with_parameters(medrue.values + part * (table1().actual - medrue.values))
    passive = medrue.assemble(q).passive
    with acceleration.compile_kinematics(compiled):
        confirmed, _, _, ok = continuation.newton(moved.mechanism, medrue.mode, q, passive)
        solved, slopes, _, known = continuation.newton(moved.mechanism, medrue.mode, q, passive, slopes=False)
        from_seed = moved.assemble(q, seed=passive)
    assert ok.all()
    assert known.all()
    assert slopes.size == 0
    assert np.max(np.abs(residual(moved.mechanism, q, solved)[0])) < 1e-13  # a tenth of the tolerance
    assert np.allclose(solved, confirmed, rtol=0, atol=1e-12)
    assert from_seed.slope is None
    assert np.allclose(moved.singular_values(from_seed), moved.singular_values(moved.assemble(q)), rtol=1e-9)


def test_limits_that_lie_a_turn_away_are_the_same_limits(five_bar, tmp_path):
    _, q, expected = five_bar
    turn = 2 * np.pi
    shifted = edited_five_bar(tmp_path, (r'lower="-3" upper="0"', f'lower="{turn - 3!r}" upper="{turn!r}"'))
    assert np.max(np.abs(shifted.assemble(q).passive - expected - [turn, 0.0])) < 1e-11


def test_goals_are_reached_through_passive_joints_without_limits(five_bar, tmp_path):
    limited, q, _ = five_bar
    robot = edited_five_bar(tmp_path, (r'(<joint name="(?:left|right)_elbow" type=)"revolute"', r'\1"continuous"'))
    positions = limited.positions(q[:12])[:, 0]
    solution = solve(robot, Goals(positions))
    assert solution.ok.all()
    assert np.max(np.abs(robot.positions(solution.q)[:, 0] - positions)) < 1e-9


def test_every_pose_of_a_3_rpr_has_one_answer_whatever_else_is_solved_with_it(tmp_path):
    """Of a 3-RPR with a platform unlike its base, two solutions can have one sign."""
    base, platform = np.array([[0, 0], [0.1591, 0], [0, 0.1]]), np.array([[0, 0], [0.1704, 0], [0.1323, 0.1610]])
    axis, slide = '<axis xyz="0 0 1"/>', '<axis xyz="1 0 0"/>'
    turn, place = -0.6, np.array([0.1, 0.1])
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    joints, home = [("wrist", "continuous", "end_0", "platform", axis)], {}
    for k in range(3):
        x, y = base[k]
        joints.append((f"turn_{k}", "continuous", "ground", f"leg_{k}", f'<origin xyz="{x} {y} 0"/>' + axis))
        joints.append((f"slide_{k}", "prismatic", f"leg_{k}", f"end_{k}", slide))
        x, y = platform[k]
        joints.append((f"pin_{k}", "fixed", "platform", f"corner_{k}", f'<origin xyz="{x} {y} 0"/>'))
        way = place + rotation @ platform[k] - base[k]
        home |= {f"slide_{k}": float(np.linalg.norm(way)), f"turn_{k}": float(np.arctan2(way[1], way[0]))}
    home["wrist"] = turn - home["turn_0"]
    urdf = urdf_of(*joints, links=["ground"]).replace('lower="-9" upper="9"', 'lower="0.05" upper="0.4"')
    (tmp_path / "rpr.urdf").write_text(urdf)
    (tmp_path / "rpr.yaml").write_text(
        "urdf: rpr.urdf\nname_mot: [slide_0, slide_1, slide_2]\nclosed_loop: [[corner_1, end_1], [corner_2, end_2]]\n"
        f"type: [3d, 3d]\nclosed_loop_axes: [[x, y], [x, y]]\nhome: {home}\nbase: {{frame: ground}}\n"
        "targets: {tool: {frame: platform}}\nparametrisation: [{origin: wrist, components: [x], sigma: 1 mm}]\n"
    )
    robot = calib.load(tmp_path / "rpr.yaml")
    q = robot.sample(100, seed=1)
    alone = [robot.close(each[None]).passive[0] for each in q]
    assert np.allclose(robot.close(q).passive, alone, atol=1e-9)  # NaN where a pose does not close
