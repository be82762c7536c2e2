"""A compensated program makes the real robot do what was meant; what cannot be is said; no other frame leaks in."""

import json
import re
import shutil

import numpy as np
import pinocchio as pin
import pytest
from click.testing import CliRunner

import calib
from calib.core.robots.closure import motion
from calib.core.rows.prediction import PositionUncertainty
from calib.programs.commands.compensate import command
from calib.programs.reaching.compensation import compensate
from calib.programs.reaching.correction_frames import known_robot, nearest_to_nominal, program_frame
from calib.programs.reaching.inverse import solve
from medrue import robot_file
from medrue.closed_form import forward
from medrue.paper_tables import table1
from medrue.workspace import target_workspace
from tests.programs.compensated_robots import angles, rms
from tests.project import EXAMPLES, write_table
from tests.saved_results import with_verdict
from tests.six_axis_arm import YAML, write_six_axis

SCARA = """<robot name="scara"><link name="l0"/><link name="l1"/><link name="l2"/><link name="l3"/><link name="hand"/>
<joint name="a" type="revolute"><parent link="l0"/><child link="l1"/><origin xyz="0 0 0.3"/><axis xyz="0 0 1"/>
<limit lower="-2.5" upper="2.5" effort="1" velocity="1"/></joint>
<joint name="b" type="revolute"><parent link="l1"/><child link="l2"/><origin xyz="0.3 0 0"/><axis xyz="0 0 1"/>
<limit lower="0.1" upper="2.5" effort="1" velocity="1"/></joint>
<joint name="c" type="prismatic"><parent link="l2"/><child link="l3"/><origin xyz="0.25 0 0"/><axis xyz="0 0 -1"/>
<limit lower="0" upper="0.2" effort="1" velocity="1"/></joint>
<joint name="d" type="revolute"><parent link="l3"/><child link="hand"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="1" velocity="1"/></joint></robot>"""


PROGRAM = np.random.default_rng(3).uniform(-0.7, 0.7, (20, 6)) + np.array([0, 0.6, 0.3, 0, 1.1, 0])


def six_axis(folder, extra=""):
    free = "  - {origin: all, components: [x, y, z], sigma: 1 mm}\n"
    free += "  - {origin: all, components: [rx, ry, rz], sigma: 2 mrad}\n"
    return calib.load(write_six_axis(folder, YAML + free + extra))


def perturbed(robot, seed, share=1.0):
    """The robot with own parameters drawn from their sigmas."""
    rng = np.random.default_rng(seed)
    drawn = {
        p.name: p.nominal_si + share * p.sigma_si * rng.standard_normal() for p in robot.parameters if not p.placement
    }
    return robot.with_parameters(drawn)


@pytest.mark.quick(0)
def test_medrue_runs_a_compensated_program_at_the_error_of_its_calibration():
    robot, workspace = calib.load(robot_file()), target_workspace()
    nominal, actual = table1().nominal, table1().actual
    rows = np.random.default_rng(0).permutation(len(workspace.q))
    used, program = workspace.q[rows[:84]], workspace.q[rows[84:]]
    noise = 4e-5 * np.random.default_rng(1).standard_normal((84, 3))
    fit = calib.fit(robot, calib.as_measurements(robot, used, forward(used, actual).p_world_tool + noise))
    held_out = rms(np.linalg.norm(fit.robot.positions(program)[:, 0] - forward(program, actual).p_world_tool, axis=1))
    compensation = compensate(fit, program)
    meant, did = forward(program, nominal), forward(compensation.q, actual)  # shares no code with the engine
    error = np.linalg.norm(did.p_world_tool - meant.p_world_tool, axis=1)
    before = np.linalg.norm(forward(program, actual).p_world_tool - meant.p_world_tool, axis=1)
    assert compensation.ok.all()
    assert compensation.kept_components == "pose"
    assert rms(error) < 1.1 * held_out  # 0.019 mm; other rows of the same workspace
    assert rms(before) > 500 * held_out
    assert rms(compensation.before) == pytest.approx(rms(before), rel=1e-3)
    assert angles(did.R_world_tool, meant.R_world_tool).max() < 3e-3  # the reflector alone was measured
    assert rms(compensation.expected) == pytest.approx(rms(error), rel=1.0)


@pytest.mark.parametrize(
    ("term", "value", "column", "cells", "shift"),
    [
        ("temperature", 2e-4, "temperature [degC]", np.full(20, 30.0), np.full(20, -2e-3)),
        ("backlash", 3e-4, "approach_j2", np.tile([1, 1, -1, -1], 5), -3e-4 * np.tile([1, 1, -1, -1], 5)),
    ],
)
def test_what_a_program_states_of_its_rows_counts_and_not_their_order(tmp_path, term, value, column, cells, shift):
    robot = six_axis(tmp_path, f"  - {{joint: j2, term: {term}}}\n").with_parameters({f"j2.{term}": value})
    write_table(tmp_path / "program.csv", [*robot.joint_names, column], PROGRAM, cells[:, None])
    compensation = compensate(robot, calib.read_poses(tmp_path / "program.csv", robot))
    np.testing.assert_allclose(compensation.q - PROGRAM, np.outer(shift, np.eye(6)[1]), atol=1e-9)
    if term == "temperature":  # without its column, joints are as warm as when they were described
        np.testing.assert_allclose(compensate(robot, PROGRAM).q, PROGRAM, atol=1e-9)


def test_a_board_that_a_camera_on_the_arm_looks_at_is_no_tool(tmp_path):
    """It stands still whatever is commanded, so that no program would need a correction."""
    robot = six_axis(tmp_path)
    yaml = (tmp_path / "arm.yaml").read_text()
    (tmp_path / "arm.yaml").write_text(yaml.replace("targets:\n", "targets:\n  board: {frame: l0, xyz: [1, 0, 0]}\n"))
    program = PROGRAM[:5]
    compensation = compensate(perturbed(calib.load(tmp_path / "arm.yaml"), 1), program)
    assert compensation.target == "ball"
    np.testing.assert_allclose(compensation.q, compensate(perturbed(robot, 1), program).q, atol=1e-9)
    (tmp_path / "arm.yaml").write_text(yaml.replace("{frame: l6, ", "{frame: l0, "))
    with pytest.raises(calib.InputError, match="its motors move none of its targets; add the tool to `targets`"):
        compensate(calib.load(tmp_path / "arm.yaml"), program)


def test_a_reflector_and_a_tracker_somewhere_else_move_no_command(robot):
    """The robot itself is nominal; priors leave part of the reflector's place in the last origin."""
    truth = robot.with_parameters({"base.x": 2.1, "base.rz": 2.0, "reflector.x": 0.03, "reflector.y": -0.008})
    q = np.random.default_rng(3).uniform(-1.2, 1.2, (60, 6))
    fit = calib.fit(robot, calib.as_measurements(robot, q, truth.positions(q)))
    fitted = fit.robot
    left = fitted.values - np.array([p.nominal_si for p in robot.parameters])
    own = np.array([not p.placement for p in robot.parameters])
    assert np.abs(left[own]).max() > 2e-4  # what would be corrected, were it taken for the robot's
    cleaned = nearest_to_nominal(fitted)
    assert np.abs((cleaned.values - np.array([p.nominal_si for p in robot.parameters]))[own]).max() < 2e-6
    assert np.abs(cleaned.positions(q) - fitted.positions(q)).max() < 1e-12
    program = q[:20] * [1, 1, 0.5, 1, 0.3, 1] + np.array([0, 0, 0.8, 0, 1.0, 0])
    for calibrated in (fit, fitted):
        assert np.abs(compensate(calibrated, program).q - program).max() < 2e-5


def test_joint_terms_limits_and_full_poses_are_kept(tmp_path):
    terms = "  - {joint: j2, term: gain, sigma: 2.0e-3}\n"
    terms += "  - {joint: all, term: harmonics, orders: [1, 7], sigma: 0.5 mrad}\n"
    terms += "  - {joint: j3, term: backlash, sigma: 0.2 mrad}\n"
    nominal = six_axis(tmp_path, terms)
    truth = perturbed(nominal, 5)
    program = np.random.default_rng(6).uniform(-0.8, 0.8, (40, 6))
    program[:, 4] += 1.2
    compensation = compensate(truth, program)
    assert compensation.ok.all()
    context = calib.as_measurements(
        nominal, program, np.zeros((40, 3))
    ).conditions  # it is approached as the program is
    did = truth.assemble(compensation.q, context=context)
    chain = truth.mechanism.targets[0]
    position, rotation, *_ = motion(truth.mechanism, chain, did.actuated, did.passive)
    meant = nominal.forward(program)  # of the target's link l6 or the target itself: positions are compared below
    assert np.abs(position - nominal.positions(program)[:, 0]).max() < 1e-9
    assert np.abs(rotation - meant[:, :3, :3]).max() < 1e-8


def test_an_arm_of_seven_joints_stays_near_the_program(tmp_path):
    urdf = (write_six_axis(tmp_path).parent / "arm.urdf").read_text()
    urdf = urdf.replace(
        "</robot>",
        '<link name="l7"/><joint name="j7" type="revolute"><parent link="l6"/><child link="l7"/>'
        '<origin xyz="0.1 0 0"/><axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="1" velocity="1"/>'
        "</joint></robot>",
    )
    (tmp_path / "seven.urdf").write_text(urdf)
    nominal = calib.load(tmp_path / "seven.urdf")
    truth = perturbed(nominal, 7, share=0.2)
    program = np.random.default_rng(8).uniform(-0.5, 0.5, (30, 7))
    program[:, 4] += 1.0
    compensation = compensate(truth, program)
    frame = program_frame(known_robot(truth))
    truth = frame.robot
    assert compensation.ok.all()
    assert np.abs(truth.forward(compensation.q) - frame.meant.forward(program)).max() < 1e-8
    for k in range(3):  # no other joints that do it are nearer: the way left has no part along the null space
        step = 1e-6
        columns = []
        for j in range(7):
            moved = compensation.q[k] + step * np.eye(7)[j]
            T, T0 = truth.forward(moved), truth.forward(compensation.q[k])
            spin = (T[:3, :3] @ T0[:3, :3].T - np.eye(3)) / step
            columns.append([*(T[:3, 3] - T0[:3, 3]) / step, spin[2, 1], spin[0, 2], spin[1, 0]])
        null = np.linalg.svd(np.array(columns).T)[2][6]
        assert abs(null @ (program[k] - compensation.q[k])) < 1e-5


def test_a_scara_keeps_the_position_and_most_of_the_orientation(tmp_path):
    (tmp_path / "scara.urdf").write_text(SCARA)
    nominal = calib.load(tmp_path / "scara.urdf")
    truth = nominal.with_parameters({"a.rz": 0.02, "c.x": 0.253, "b.rx": 0.002})
    rng = np.random.default_rng(9)
    program = rng.uniform([-1.5, 0.5, 0.03, -1.0], [1.5, 2.0, 0.15, 1.0], (25, 4))
    compensation = compensate(truth, program)
    frame = program_frame(known_robot(truth))
    assert compensation.kept_components == "position"
    assert compensation.ok.all()
    meant, did, naive = frame.meant.forward(program), frame.robot.forward(compensation.q), frame.robot.forward(program)
    assert np.abs(did[:, :3, 3] - meant[:, :3, 3]).max() < 1e-9
    after, before = (angles(T[:, :3, :3], meant[:, :3, :3]) for T in (did, naive))
    assert (after <= before + 1e-9).all()
    assert after.max() < 2.5e-3  # the tilt of 2 mrad that four joints cannot take out


def test_goals_are_on_one_branch_and_tell_a_nominal_controller_what_to_be_told(tmp_path):
    nominal = six_axis(tmp_path)
    truth = perturbed(nominal, 10)
    way = np.linspace(0, 1, 60)[:, None]
    joints = (1 - way) * [0.2, -0.4, 0.6, 0.3, 0.9, 0.1] + way * [-0.5, 0.2, 0.9, -0.6, 1.4, 1.0]
    T = nominal.forward(joints)
    T[:, :3, 3] = nominal.positions(joints)[:, 0]
    program = calib.Goals(T[:, :3, 3], T[:, :3, :3], target="ball")
    compensation = compensate(truth, program)
    assert compensation.ok.all()
    assert np.abs(truth.positions(compensation.q)[:, 0] - T[:, :3, 3]).max() < 1e-9
    assert np.abs(np.diff(compensation.q, axis=0)).max() < 0.1
    positions, rotations = compensation.controller_poses(nominal)
    again = solve(nominal, calib.Goals(positions, rotations, target="ball"), near=compensation.q)
    assert np.abs(nominal.positions(again.q)[:, 0] - nominal.positions(compensation.q)[:, 0]).max() < 1e-9
    assert np.abs(positions - nominal.positions(compensation.q)[:, 0]).max() < 1e-12


def test_goals_are_in_the_frame_of_the_description_wherever_the_tracker_stands(tmp_path):
    """The description sees the base from another frame; the tracker's own is a third one."""
    (tmp_path / "arm.urdf").write_text((EXAMPLES / "arm.urdf").read_text())
    seen = "base: {frame: base_link, pose: unknown, xyz: [0.4, -0.2, 0.1], rpy: [0, 0, 90 deg]}"
    text = (EXAMPLES / "arm.yaml").read_text()
    (tmp_path / "arm.yaml").write_text(re.sub("base: .*", seen, text))
    robot, plain = calib.load(tmp_path / "arm.yaml"), calib.load(EXAMPLES / "arm.yaml")
    q = np.array([[0.3, 0.2, 0.4, 0.1, 0.9, 0.2], [0.1, 0.3, 0.5, 0.1, 0.8, 0.3]])
    goals = robot.positions(q)[:, 0]
    turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    assert np.abs(goals - (plain.positions(q)[:, 0] @ turn.T + [0.4, -0.2, 0.1])).max() < 1e-12
    own = {
        p.name: v for p, v in zip(plain.parameters, perturbed(plain, 11, 0.3).values, strict=True) if not p.placement
    }
    towers = ({}, {"base.x": 2.1, "base.ry": 0.3, "base.rz": 2.0})
    by_tower = [compensate(robot.with_parameters(own | tower), calib.Goals(goals)) for tower in towers]
    in_base = compensate(plain.with_parameters(own), calib.Goals(plain.positions(q)[:, 0]))
    assert np.abs(by_tower[0].q - q).max() > 1e-4
    for other in (by_tower[1], in_base):
        assert np.abs(other.q - by_tower[0].q).max() < 1e-7


def test_what_cannot_be_is_not_clipped_but_said(tmp_path):
    robot = perturbed(six_axis(tmp_path), 12)
    program = np.array(
        [[0.1, 0.2, 0.3, 0.4, 0.8, 0.1], [0.1, 0.2, 0.3, 3.2, 0.8, 0.1], [2.9999, 0.2, 0.3, 0.4, 0.8, 0.1]]
    )
    robot = robot.with_parameters({"j1.rz": -5e-3})
    compensation = compensate(robot, program)
    assert compensation.ok.tolist() == [True, False, False]
    assert np.isnan(compensation.q[1:]).all()
    assert "joint 'j4': 183.346 deg in the program, 171.887 deg allowed" in compensation.reasons[1]
    assert "joint 'j1': 17" in compensation.reasons[2]
    assert "deg needed" in compensation.reasons[2]
    assert len(compensation.unreached_rows()) == 2


def test_out_of_reach_is_said_with_the_distance(tmp_path):
    """Stretched out, the nominal arm reaches 0.6 + 0.6 and the real one 3 mm less."""
    nominal = six_axis(tmp_path)
    short = nominal.with_parameters({"j3.z": 0.597})
    straight = [0.0, 0.3, -float(np.arctan2(0.6, 0.05)), 0.0, 0.02, 0.0]
    compensation = compensate(short, np.array([straight, [0.1, 0.3, 0.4, 0.1, 0.7, 0.0]]))
    assert compensation.ok.tolist() == [False, True]
    assert re.match(r"is out of reach by [23]\.\d+ mm", compensation.reasons[0])
    far = compensate(short, calib.Goals(np.array([[5.0, 0.0, 0.5]])))
    assert "by the nominal robot misses by" in far.reasons[0]


def test_poses_that_do_not_close_are_listed():
    robot = calib.load(robot_file())
    q = np.array([target_workspace().q[0], target_workspace().q[0]])
    q[1, 1] += 2.0
    compensation = compensate(robot, q)
    assert compensation.ok.tolist() == [True, False]
    assert "cannot be assembled" in compensation.reasons[1]
    assert np.isnan(compensation.before[1])


def test_distances_lie_within_their_limits_as_often_as_stated():
    """Against draws from the covariance, round, flat and long."""
    rng = np.random.default_rng(13)
    for axes in ([1.0, 1.0, 1.0], [1.0, 1.0, 1e-3], [1.0, 0.2, 0.1], [1.0, 0.0, 0.0]):
        turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        covariance = 1e-10 * turn @ np.diag(np.square(axes)) @ turn.T
        known = PositionUncertainty(np.zeros((1, 1, 3)), covariance[None, None], 1.959964)
        low, high = known.distance95[:, 0, 0]
        drawn = np.linalg.norm(1e-5 * rng.standard_normal((20000, 3)) * axes, axis=1)
        assert np.mean((drawn > low) & (drawn < high)) == pytest.approx(0.96, abs=0.02)  # two moments are matched


@pytest.mark.quick(0)
@pytest.mark.parametrize("keep", ["pose", "axis"])
def test_orientations_are_off_by_what_is_expected(tmp_path, keep):
    """Truths drawn from the covariance of a calibration by poses run its compensated program."""
    nominal = six_axis(
        tmp_path, "instruments:\n  six: {kind: pose, target: ball, sigma: 0.05 mm, sigma_angle: 0.2 mrad}\n"
    )
    rng = np.random.default_rng(21)
    truth = perturbed(nominal, 20)
    q = rng.uniform(-1.2, 1.2, (25, 6))
    poses = truth.forward(q)
    noisy = [pin.exp3(2e-4 * rng.standard_normal(3)) @ R for R in poses[:, :3, :3]]
    seen = [
        (*(p + 5e-5 * rng.standard_normal(3)), *pin.Quaternion(R).coeffs())
        for p, R in zip(truth.positions(q)[:, 0], noisy, strict=True)
    ]
    header = [*nominal.joint_names, *(f"six_{axis}" for axis in ("x", "y", "z", "qx", "qy", "qz", "qw"))]
    write_table(tmp_path / "poses.csv", header, q, np.array(seen))
    fit = calib.fit(nominal, calib.read_measurements(tmp_path / "poses.csv", nominal))
    program = rng.uniform(-0.8, 0.8, (6, 6)) + np.array([0, 0, 0, 0, 1.2, 0])
    compensation = compensate(fit, program, keep=keep)
    assert compensation.ok.all()
    meant = nominal.forward(program)[:, :3, :3]
    root = np.linalg.cholesky(fit.covariance.values + 1e-30 * np.eye(len(fit.statistics.covariance)))
    errors = []
    for _ in range(300):
        values = fit.robot.values.copy()
        values[fit.unknowns.index] += root @ rng.standard_normal(len(root))
        did = nominal.with_parameters(values).forward(compensation.q)[:, :3, :3]
        cosine = np.sum(did[:, :, 2] * meant[:, :, 2], axis=1)
        errors.append(angles(did, meant) if keep == "pose" else np.arccos(np.clip(cosine, -1, 1)))
    errors = np.array(errors)
    assert np.sqrt(np.mean(errors**2, axis=0)) == pytest.approx(compensation.expected_angle, rel=0.15)  # of 300 draws
    inside = (errors > compensation.low95_angle) & (errors < compensation.high95_angle)
    assert np.mean(inside) == pytest.approx(0.96, abs=0.025)
    really = angles(truth.forward(compensation.q)[:, :3, :3], meant)
    assert (
        keep != "pose" or really.max() < 3 * compensation.expected_angle.max() < 0.3 * compensation.before_angle.max()
    )
    assert compensation.before_angle == pytest.approx(
        angles(fit.robot.forward(program)[:, :3, :3], meant) if keep == "pose" else compensation.before_angle, rel=1e-4
    )


def test_angles_are_not_known_where_the_position_alone_is_kept(tmp_path):
    compensation = compensate(
        perturbed(six_axis(tmp_path), 5), np.array([[0.1, 0.2, 0.3, 0.4, 0.8, 0.1]]), keep="position"
    )
    assert np.isnan(
        [compensation.before_angle, compensation.expected_angle, compensation.low95_angle, compensation.high95_angle]
    ).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [({"keep": "posture"}, "keep 'posture'"), ({"program": np.zeros((2, 5))}, "expected \\(n, 6\\)")],
)
def test_wrong_arguments_are_refused(tmp_path, arguments, message):
    robot = six_axis(tmp_path)
    with pytest.raises(calib.CalibrationError, match=message):
        compensate(robot, **{"program": np.zeros((2, 6)), **arguments})


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory):
    """A result folder of the arm of the examples."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("calib.pictures.entry_points", lambda group: ())  # pages have tests of their own
        robot = calib.load(EXAMPLES / "arm.yaml")
        data = calib.read_measurements(EXAMPLES / "arm_simulated.csv", robot)
        folder = tmp_path_factory.mktemp("result") / "arm"
        calib.fit(robot, data).save(folder)
    return folder


JOINTS = ",".join(f"joint_{k}" for k in range(1, 7))
NAMES = "reflector_x,reflector_y,reflector_z"


def run(folder, text, *options, robot=EXAMPLES / "arm.yaml", result=None):
    (folder / "program.csv").write_text(text)
    arguments = [str(robot), str(folder / "program.csv"), "--result", str(result), "--out", str(folder / "out.csv")]
    return CliRunner().invoke(command, [*arguments, *options])


def test_command_writes_a_program_with_marks_and_figures(tmp_path, calibrated):
    text = f"pose,{JOINTS}\nA,0.1,0.2,0.3,0.1,0.8,0.1\nB,0.1,0.2,2.6,0.1,0.8,0.1\n"
    refused = run(tmp_path, text, result=calibrated)
    assert refused.exit_code == 2
    assert "line 3 (pose B) is past the limit of joint 'joint_3'" in refused.output
    assert not (tmp_path / "out.csv").exists()
    target = tmp_path / "out.json"
    outcome = run(tmp_path, text, "--skip-unreachable", "--json", str(target), result=calibrated)
    assert outcome.exit_code == 0, outcome.output
    lines = (tmp_path / "out.csv").read_text().splitlines()
    turns = "before_angle [mrad],expected_angle [mrad],low95_angle [mrad],high95_angle [mrad]"
    assert lines[1].endswith(f"before [mm],expected [mm],low95 [mm],high95 [mm],{turns},status")
    assert lines[2].endswith(",ok")
    assert lines[3].startswith("B,,,,,,,")
    content = json.loads(target.read_text())
    assert (content["n_rows"], content["n_unreachable"], content["kept"]) == (2, 1, "pose")
    assert content["rows"][1]["joints"] is None
    robot = calib.load(EXAMPLES / "arm.yaml")
    with pytest.raises(calib.DataError, match="is empty"):  # nobody runs the marked row by mistake
        calib.read_poses(tmp_path / "out.csv", robot)


def test_command_gives_poses_for_controllers_that_take_them(tmp_path, calibrated):
    text = f"{NAMES},reflector_ax,reflector_ay,reflector_az\n0.5,0.1,0.6,0,0.2,1\n"
    assert run(tmp_path, text, "--quiet", result=calibrated).exit_code == 0
    header, row = (tmp_path / "out.csv").read_text().splitlines()[1:3]
    cells = dict(zip(header.split(","), row.split(","), strict=True))
    q = np.radians([float(cells[f"joint_{k} [deg]"]) for k in range(1, 7)])
    robot = calib.load(EXAMPLES / "arm.yaml")
    told = [float(cells[f"reflector_{axis} [mm]"]) / 1e3 for axis in "xyz"]
    assert np.abs(robot.positions(q)[0, 0] - told).max() < 1e-9
    assert 1e-4 < np.abs(np.array(told) - [0.5, 0.1, 0.6]).max() < 5e-3


def test_columns_that_are_not_written_are_named(tmp_path, calibrated):
    row = "0.1,0.2,0.3,0.1,0.8,0.1"
    text = f"pose,{JOINTS},load [kg],speed [mm],note,reflector_x\nA,{row},1,9,x,0\n"
    said = "program.csv: not in the written table: speed, note\n"
    assert said in run(tmp_path, text, result=calibrated).output
    assert "not in the written table" not in run(tmp_path, f"pose,{JOINTS}\nA,{row}\n", result=calibrated).output


@pytest.mark.quick(2)
@pytest.mark.parametrize(
    ("text", "options", "code", "message"),
    [
        ("a,b\n1,2\n", (), 2, "no position columns"),
        (f"{JOINTS}\n0,0,0,0,0,x\n", (), 2, "line 2, column 'joint_6'"),
        ("joint_1,joint_2\n0,0\n", (), 2, "no column 'joint_3'"),
        (f"joint_1,{NAMES}\n0,1,1,1\n", (), 2, "none for joint 'joint_2'; give all joints, or none"),
        (f"{JOINTS} [mm]\n0,0,0,0,0,0\n", (), 2, "column 'joint_6'"),
        (f"{JOINTS},before,expected,status\n0,0,0,0,0,0,1,1,ok\n", (), 2, "is compensated already"),
        (f"{NAMES}\n0.5,0.1,0.6\n", ("--keep", "pose"), 2, "leave it out"),
        (f"{NAMES}\n9,0,0\n", (), 2, "1 row of 1 cannot be compensated"),
        (f"{NAMES}\n9,0,0\n", ("--skip-unreachable",), 2, "1 row of 1 cannot be compensated"),
        (f"{NAMES},reflector_rx\n0.5,0.1,0.6,0\n", (), 2, "no column 'reflector_ry'"),
        (f"{JOINTS}\n0,0,0,0,0,0\n", ("--keep", "all"), 2, "'all' is not one of"),
        (f"{JOINTS}\n0,0,0,0,0,0\n", ("--grid", "5,5,5"), 2, "--grid: PROGRAM has joints"),
        (f"{NAMES}\n0.5,0.1,0.6\n", ("--grid", "5,5"), 2, "--grid '5,5': write three numbers of nodes"),
        (f"{NAMES}\n0.5,0.1,0.6\n", ("--grid", "5,5,x"), 2, "--grid '5,5,x': write three numbers of nodes"),
        (f"{NAMES}\n0.5,0.1,0.6\n", ("--grid", "1,1,1"), 2, "a correction depends on the orientation"),
    ],
)
def test_wrong_programs_are_refused_in_one_line(tmp_path, calibrated, text, options, code, message):
    outcome = run(tmp_path, text, *options, result=calibrated)
    assert outcome.exit_code == code
    assert message in outcome.output
    assert outcome.output.startswith("Usage") or outcome.output.count("\n") == 1
    assert not (tmp_path / "out.csv").exists()


def test_a_result_folder_is_a_robot_and_something_else_needs_one(tmp_path, calibrated):
    text = f"{NAMES},reflector_ax,reflector_ay,reflector_az\n0.5,0.1,0.6,0,0.2,1\n"
    files = []
    for robot, options in ((EXAMPLES / "arm.yaml", ["--result", str(calibrated)]), (calibrated, [])):
        (tmp_path / "program.csv").write_text(text)
        out = tmp_path / f"{len(files)}.csv"
        outcome = CliRunner().invoke(command, [str(robot), str(tmp_path / "program.csv"), "--out", str(out), *options])
        assert outcome.exit_code == 0, outcome.output
        files.append(out.read_text())
    assert files[0] == files[1]
    outcome = CliRunner().invoke(command, [str(EXAMPLES / "arm.yaml"), str(tmp_path / "program.csv"), "--out", "x.csv"])
    assert outcome.exit_code == 2
    assert "is not a result folder; give that as ROBOT, or with --result DIR" in outcome.output


def test_a_failed_result_compensates_nothing(tmp_path, calibrated):
    shutil.copytree(calibrated, tmp_path / "failed")
    with_verdict(tmp_path / "failed", "FAIL", "it was wrong")
    outcome = run(tmp_path, f"{JOINTS}\n0,0,0.3,0,0.5,0\n", result=tmp_path / "failed")
    assert (outcome.exit_code, "it was wrong" in outcome.output) == (3, True), outcome.output
