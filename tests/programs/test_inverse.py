"""Inverse kinematics through loops: equal to the closed form, within limits, in home's mode, honest about misses."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.optimize import minimize

from calib import UnreachablePoseError, compensate, load
from calib.core.base.errors import DataError
from calib.core.data.measurement_files import read_poses
from calib.core.robots.closure import motion
from calib.programs.commands.solve import command
from calib.programs.reaching.goals import Goals, read_goals
from calib.programs.reaching.inverse import solve
from medrue import robot_file
from medrue.closed_form import forward
from medrue.closed_form_inverse import inverse
from medrue.paper_tables import table1
from medrue.workspace import target_workspace
from tests.small_robots import ARM_YAML, write_arm

ARM = """<robot name="arm"><link name="l0"/><link name="l1"/><link name="l2"/><link name="l3"/><link name="hand"/>
<joint name="a" type="revolute"><parent link="l0"/><child link="l1"/><origin xyz="0 0 0.3"/><axis xyz="0 0 1"/>
<limit lower="-2.9" upper="2.9" effort="1" velocity="1"/></joint>
<joint name="b" type="revolute"><parent link="l1"/><child link="l2"/><origin xyz="0.1 0 0"/><axis xyz="0 1 0"/>
<limit lower="-1.5" upper="1.5" effort="1" velocity="1"/></joint>
<joint name="c" type="revolute"><parent link="l2"/><child link="l3"/><origin xyz="0.4 0 0"/><axis xyz="0 1 0"/>
<limit lower="0.1" upper="2.5" effort="1" velocity="1"/></joint>
<joint name="d" type="prismatic"><parent link="l3"/><child link="hand"/><origin xyz="0.2 0 0"/><axis xyz="1 0 0"/>
<limit lower="0" upper="0.3" effort="1" velocity="1"/></joint></robot>"""
LOWER, UPPER = np.array([-2.9, -1.5, 0.1, 0.0]), np.array([2.9, 1.5, 2.5, 0.3])


@pytest.fixture(scope="module")
def medrue_robot():
    return load(robot_file())


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    path.write_text(ARM)
    return load(path)


def arm_position(q):
    """The hand of the arm by hand: out along the radius, up against the angles."""
    a, b, c, d = q
    out = 0.1 + 0.4 * np.cos(b) + (0.2 + d) * np.cos(b + c)
    return np.array([out * np.cos(a), out * np.sin(a), 0.3 - 0.4 * np.sin(b) - (0.2 + d) * np.sin(b + c)])


@pytest.mark.parametrize("values", [table1().nominal, table1().actual], ids=["nominal", "calibrated"])
def test_full_poses_give_the_joints_of_the_closed_form(medrue_robot, values):
    T = target_workspace().T_world_tool
    solution = solve(medrue_robot.with_parameters(values), Goals(T[:, :3, 3], T[:, :3, :3]))
    assert solution.ok.all()
    assert np.abs(solution.q - inverse(T, values)).max() < 1e-10
    assert solution.miss_position.max() < 1e-12
    assert solution.unreached_goals() == []


def test_positions_and_axes_are_reached_in_home_s_assembly_mode(medrue_robot):
    T = target_workspace().T_world_tool[::10]
    for goals in (Goals(T[:, :3, 3]), Goals(T[:, :3, 3], directions=7 * T[:, :3, 2])):
        solution = solve(medrue_robot, goals)
        reached = forward(solution.q, table1().nominal)  # the closed form knows only the right assembly mode
        assert solution.ok.all()
        assert reached.closes.all()
        assert np.abs(reached.p_world_tool - T[:, :3, 3]).max() < 1e-11
        if goals.directions is not None:
            assert np.abs(reached.R_world_tool[:, :, 2] - T[:, :3, 2]).max() < 1e-11


def test_jacobian_of_the_actuated_joints_agrees_with_differences_of_the_closed_form(medrue_robot):
    q = target_workspace().q[::60]
    passive = medrue_robot.assemble(q).passive
    target = medrue_robot.mechanism.targets[0]
    position, rotation, jacobian, _ = motion(medrue_robot.mechanism, target, q, passive)
    here = forward(q, table1().nominal)
    assert np.abs(position - here.p_world_tool).max() < 1e-12
    assert np.abs(rotation - here.R_world_tool).max() < 1e-12
    step = 1e-5  # truncation 1e-10, rounding 1e-11
    for j, direction in enumerate(np.eye(6) * step):
        above, below = forward(q + direction, table1().nominal), forward(q - direction, table1().nominal)
        slope = (above.p_world_tool - below.p_world_tool) / (2 * step)
        turn = (above.R_world_tool - below.R_world_tool) @ np.transpose(here.R_world_tool, (0, 2, 1)) / (2 * step)
        spin = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1)
        assert np.abs(jacobian[:, :3, j] - slope).max() < 1e-8
        assert np.abs(jacobian[:, 3:, j] - spin).max() < 1e-8


def test_reachable_positions_of_an_arm_are_all_found_within_limits(arm):
    q = np.random.default_rng(1).uniform(LOWER, UPPER, (200, 4))
    goals = np.array([arm_position(row) for row in q])
    solution = solve(arm, Goals(goals))
    assert solution.ok.all()
    assert np.abs(np.array([arm_position(row) for row in solution.q]) - goals).max() < 1e-9
    assert (solution.q >= LOWER).all()
    assert (solution.q <= UPPER).all()


def test_redundant_joints_stay_nearest_to_where_they_are_wanted(arm):
    """Against a general constrained minimiser, from the same side."""
    near = np.array([0.3, 0.2, 0.9, 0.1])
    goal = arm_position(np.array([0.5, -0.2, 1.4, 0.2]))
    result = solve(arm, Goals(goal[None]), near=near).q[0]
    scale = np.array([1, 1, 1, arm.mechanism.length])
    best = minimize(
        lambda q: np.sum(((q - near) / scale) ** 2),
        result + 0.02,
        constraints={"type": "eq", "fun": lambda q: arm_position(q) - goal},
        method="SLSQP",
        options={"ftol": 1e-14},
    )
    assert np.abs(result - best.x).max() < 1e-5


def test_joints_are_nearest_through_loops_and_at_limits(medrue_robot):
    """Against a general constrained minimiser of the closed form; near the end of the rail, which holds some."""
    robot, scale = medrue_robot, medrue_robot.mechanism.joint_scale
    near = robot.home.copy()
    near[0] = 0.7
    q = near + np.random.default_rng(5).uniform(-0.25, 0.25, (8, 6)) * scale
    q[:, 0] = np.minimum(q[:, 0], 0.68)
    q = q[robot.close(q).ok]
    goals = forward(q, table1().nominal).p_world_tool
    solution = solve(robot, Goals(goals), near=near)
    assert solution.ok.all()
    assert 0 < np.count_nonzero(solution.q[:, 0] == 0.7) < len(q)
    compared = 0
    for start, goal in zip(solution.q, goals, strict=True):
        best = minimize(
            lambda joints: np.sum(((joints - near) / scale) ** 2),
            start,
            constraints={
                "type": "eq",
                "fun": lambda joints, goal=goal: forward(joints[None], table1().nominal).p_world_tool[0] - goal,
            },
            bounds=[(0.0, 0.7), *[(None, None)] * 5],
            method="SLSQP",
            options={"ftol": 1e-15, "maxiter": 300},
        )
        if best.success and robot.close(best.x[None]).ok[0]:
            compared += 1
            assert np.abs((start - best.x) / scale).max() < 1e-4, (start, best.x)  # SLSQP differences the goal
    assert compared >= 3


def test_whole_turns_are_taken_out(arm):
    q = np.array([[2.8, 0.3, 0.8, 0.1]])
    positions = np.array([arm_position(row) for row in q])
    assert abs(solve(arm, Goals(positions), near=q).q[0, 0] - 2.8) < 1e-6


def test_the_miss_of_a_far_goal_is_its_distance_from_the_workspace(arm):
    """Straight ahead the arm reaches 0.1 + |0.4 + 0.5 turned by c = 0.1|, up and down by turning."""
    reach = np.hypot(0.4 + 0.5 * np.cos(0.1), 0.5 * np.sin(0.1))
    solution = solve(arm, Goals(np.array([[2.0, 0.0, 0.3], [0.6, 0.0, 0.3]])))
    assert solution.ok.tolist() == [False, True]
    assert abs(solution.miss_position[0] - (2.0 - 0.1 - reach)) < 1e-6
    with pytest.raises(UnreachablePoseError, match=r"goal 1 misses by 1001\.\d+ mm"):
        solution.require_all()


@pytest.mark.quick(0)
def test_medrue_goals_out_of_reach_are_named_and_the_others_solved(medrue_robot):
    T = target_workspace().T_world_tool[:4].copy()
    T[1, 0, 3] -= 1.0  # the rail ends 36 mm further on
    solution = solve(medrue_robot, Goals(T[:, :3, 3], T[:, :3, :3], names=("a", "b", "c", "d")))
    assert solution.ok.tolist() == [True, False, True, True]
    assert 0.5 < solution.miss_position[1] < 1.0
    assert 0.0 <= solution.q[1, 0] <= 0.7
    with pytest.raises(
        UnreachablePoseError, match=r"goal b misses by .* mm and .* deg; goals are in the measurement frame; move"
    ):
        solution.require_all()


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"positions": np.zeros((2, 2))}, "shape"),
        ({"positions": np.array([[0.0, np.inf, 0.0]])}, "goal 1: positions are not finite"),
        ({"rotations": np.zeros((2, 3, 3))}, "goal 1: the orientation"),
        ({"rotations": np.tile(-np.eye(3), (2, 1, 1))}, "not a rotation"),
        ({"directions": np.zeros((2, 3))}, "no length"),
        ({"rotations": np.tile(np.eye(3), (2, 1, 1)), "directions": np.ones((2, 3))}, "not both"),
        ({"names": ("a",)}, "1 names"),
    ],
)
def test_wrong_goals_are_refused(fields, message):
    with pytest.raises(DataError, match=message):
        Goals(**{"positions": np.zeros((2, 3)), **fields})


@pytest.mark.quick(0)
def test_a_coordinate_that_is_not_asked_for_is_left_as_it_comes(tmp_path):
    """A five-bar off its plane by a hair reaches x and y, and no height."""
    nominal = load("docs/examples/five_bar.yaml")
    robot = nominal.with_parameters({"base.z": 1e-5, "left_end.x": 0.2995})
    positions = nominal.positions(nominal.sample(8, seed=1))[:, 0]
    assert not np.any(solve(robot, positions).ok)
    flat = positions * [1, 1, np.nan]
    solution = solve(robot, flat)
    reached = robot.positions(solution.q[solution.ok])[:, 0]
    assert np.sum(solution.ok) > 5  # a shorter link does not reach all
    np.testing.assert_allclose(reached[:, :2], positions[solution.ok, :2], atol=1e-9)
    np.testing.assert_allclose(reached, solution.positions[solution.ok], atol=1e-9)
    cells = "\n".join(f"{1e3 * x:.12g},{1e3 * y:.12g}," for x, y, _ in flat)
    goals = read_goals(write(tmp_path / "goals.csv", f"pen_x [mm],pen_y [mm],pen_z [mm]\n{cells}\n"), robot)
    np.testing.assert_allclose(goals.positions, flat, atol=1e-12)
    with pytest.raises(DataError, match="goal 1: positions are not finite"):
        Goals(np.full((1, 3), np.nan))
    flat[4, 2] = 0.02
    with pytest.raises(DataError, match="goal 5: its NaN coordinates are not those of the first goal"):
        solve(robot, flat)
    assert len(solve(robot, Goals(flat)).q) == 8
    flat[4, 2] = np.nan
    with pytest.raises(DataError, match="goal 1: a coordinate is empty; a program needs all three"):
        compensate(robot, Goals(flat))


def test_an_unknown_target_and_a_wrong_start_are_refused(arm):
    with pytest.raises(DataError, match="did you mean 'hand'"):
        solve(arm, Goals(np.zeros((2, 3)), target="hnad"))
    with pytest.raises(DataError, match="near: 3 rows"):
        solve(arm, Goals(np.zeros((2, 3))), near=np.zeros((3, 4)))


def write(path, text):
    path.write_text(text)
    return str(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x,y\n1,2\n", "expected hand_x, hand_y, hand_z"),
        ("hand_x,hand_y\n1,2\n", "no column 'hand_z'"),
        ("hand_x,hand_y,hand_z\n1,2,three\n", "line 2, column 'hand_z'"),
        ("hand_x,hand_y,hand_z [deg]\n1,2,3\n", "unit"),
        ("hand_x,hand_y,hand_z,hand_rx\n1,2,3,0\n", "no column 'hand_ry'"),
        ("hand_x,hand_y,hand_z,hand_ax [mm],hand_ay,hand_az\n1,2,3,0,0,1\n", "a direction has no unit"),
        ("hand_x,hand_y,hand_z,hand_ax,hand_ay,hand_az\n1,2,3,0,0,0\n", "line 2: the direction has no length"),
        ("hand_x,hand_y,hand_z,hand_ax,hand_rx\n1,2,3,0,0\n", "exclude each other"),
        ("hand_x,hand_y,hand_z\n", "no rows"),
    ],
)
def test_wrong_files_are_refused(arm, tmp_path, text, message):
    with pytest.raises(DataError, match=message):
        read_goals(write(tmp_path / "goals.csv", text), arm)


def test_command_writes_joint_values_that_predict_the_targets(arm, tmp_path):
    robot = write(tmp_path / "arm.urdf", ARM)
    goal = arm_position(np.array([0.5, -0.2, 1.4, 0.2])) * 1e3
    targets = write(tmp_path / "t.csv", "pose,hand_x [mm],hand_y [mm],hand_z [mm]\np1,{},{},{}\n".format(*goal))
    out = tmp_path / "q.csv"
    run = CliRunner().invoke(command, [robot, targets, "--out", str(out), "--json", str(tmp_path / "q.json")])
    assert run.exit_code == 0, run.output
    header, row = out.read_text().splitlines()[1:-1]
    assert header == "pose,a [deg],b [deg],c [deg],d [mm],hand_x [mm],hand_y [mm],hand_z [mm]"
    cells = [float(cell) for cell in row.split(",")[1:]]
    q = np.array([*np.radians(cells[:3]), cells[3] / 1e3])
    assert np.abs(arm_position(q) * 1e3 - goal).max() < 1e-6
    entry = json.loads((tmp_path / "q.json").read_text())["targets"][0]
    assert (entry["pose"], entry["reached"]) == ("p1", True)
    assert entry["joints"]["d [mm]"] == cells[3]


def test_command_names_unreachable_targets_and_skips_them_only_on_request(tmp_path):
    robot = write(tmp_path / "arm.urdf", ARM)
    targets = write(tmp_path / "t.csv", "pose,hand_x,hand_y,hand_z\nfar,2,0,0.3\nnear,0.6,0,0.3\n")
    out = tmp_path / "q.csv"
    run = CliRunner().invoke(command, [robot, targets, "--out", str(out)])
    assert run.exit_code == 2
    assert "line 2 (pose far) misses by 1001." in run.output
    assert not out.exists()
    run = CliRunner().invoke(command, [robot, targets, "--out", str(out), "--skip-unreachable"])
    assert run.exit_code == 0
    assert "pose far" in run.stderr
    assert [line.split(",")[0] for line in out.read_text().splitlines()[2:-1]] == ["near"]


def test_conditions_of_goals_count(tmp_path, run_calib):
    path = write_arm(tmp_path, ARM_YAML + "  - {joint: slide, term: backlash}\n  - {joint: turn, term: drift}\n")
    robot = load(path)
    goal = robot.positions([0.3, 0.2, 0.4])[0, 0]
    rows = [",".join(map(str, (*map(float, goal), side, 3600))) for side in (1, -1)]
    (tmp_path / "goals.csv").write_text("\n".join(["tip_x,tip_y,tip_z,approach_slide,time [s]", *rows]))
    (tmp_path / "values.csv").write_text("parameter,value,unit\nslide.backlash,0.5,mm\nturn.drift,2,mrad\n")
    run = run_calib(
        *("solve", "arm.yaml", "goals.csv", "--parameters", "values.csv", "--out", "solved.csv"), cwd=tmp_path
    )
    assert run.code == 0, run.err
    told = read_poses(tmp_path / "solved.csv", robot)  # the conditions with it, for whoever predicts from the file
    real = robot.with_parameters({"slide.backlash": 5e-4, "turn.drift": 2e-3})
    np.testing.assert_allclose(real.positions(told.joints, told.conditions)[:, 0], [goal, goal], atol=1e-9)
    there = told.joints + np.array([[2e-3, 5e-4, 0.0], [2e-3, -5e-4, 0.0]])
    np.testing.assert_allclose(robot.positions(there)[:, 0], [goal, goal], atol=1e-9)
