"""Gravity's direction: known, per setup, read at each visit, found; torques against potential energy by other code."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib
from calib.core.robots.terms.term import Context
from tests.core.robots.terms.test_compliance import ARM_YAML, HEADER, MASSES, G, arm, centres, columns, joint, poses
from tests.core.robots.terms.test_compliance import torques as slopes
from tests.exporting.function_robots import exported
from tests.kind_checks import assert_positions_move_as_differences_say
from tests.project import write_table

DOWN = np.array([0.3, -0.5, 0.6])


def torques(q, down):
    """Slope of the potential energy -m g d.p, by central differences, (n, 3)."""
    down = np.broadcast_to(down, (len(q), 3))
    return np.concatenate(
        [slopes(lambda row, d=d: (None, -G * MASSES @ centres(row)[:4] @ d), q[[k]]) for k, d in enumerate(down)]
    )


def described(folder, gravity, *more):
    return arm(folder, "".join([ARM_YAML, *more, f"gravity: {gravity}\n"]))[0]


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def some_directions(n, seed, tilt=0.5):
    return unit(np.array([0.0, 0.0, -1.0]) + tilt * np.random.default_rng(seed).uniform(-1, 1, (n, 3)))


def test_a_direction_that_is_known_loads_the_joints(tmp_path):
    robot = described(tmp_path, f"{{down: {DOWN.tolist()}}}")
    q = poses(robot, 12, 0)
    # differences of some 10 J by 1e-5 rad are good to 1e-9 N m, and their curvature to as much
    assert np.allclose(columns(robot, q), torques(q, unit(DOWN)), rtol=0, atol=1e-6)
    assert np.abs(columns(robot, q)[:, 0]).min() > 0.1  # a joint with a vertical axis would hold nothing


def test_every_setup_has_its_direction(tmp_path):
    setups = "base: {frame: base, pose: unknown}\nsetups: {floor: [], wall: [base], ramp: [base]}\n"
    text = ARM_YAML.replace("base: {frame: base}\n", setups)
    robot, _ = arm(tmp_path, text + "gravity: {setups: {wall: [2, 0, 0], ramp: [0, 0.5, -1]}}\n")
    q = poses(robot, 6, 1)
    names = ["floor", "wall", "ramp", "wall", "floor", "ramp"]
    write_table(tmp_path / "data.csv", f"{HEADER},setup", q, np.zeros((6, 3)), names)
    data = calib.read_measurements(tmp_path / "data.csv", robot)
    stated = {"floor": [0, 0, -1], "wall": [1, 0, 0], "ramp": unit(np.array([0, 0.5, -1]))}
    down = np.array([stated[name] for name in names])
    assert np.allclose(columns(robot, data.joints, data.conditions), torques(q, down), rtol=0, atol=1e-6)
    last = data[np.array([5, 1])]
    assert np.allclose(columns(robot, last.joints, last.conditions), torques(q, down)[[5, 1]], rtol=0, atol=1e-6)


@pytest.mark.parametrize("sensor", ["gravity", "accelerometer", "tilts"])
def test_a_sensor_on_a_link_that_moves_reads_the_direction_at_each_visit(tmp_path, sensor):
    robot = described(tmp_path, "{frame: upper}")
    q = poses(robot, 10, 2)
    down = some_directions(10, 3)
    read = Rotation.from_euler("ZY", q[:, :2]).inv().apply(down)  # the link `upper` is turned about z, then y
    more = {f"{sensor}_{axis} [m/s^2]": G * x for axis, x in zip("xyz", read.T, strict=True)}
    if sensor == "accelerometer":  # at rest it is held up against gravity
        more = {name: -x for name, x in more.items()}
    if sensor == "tilts":
        more = {
            "gravity_tilt_x [deg]": np.degrees(np.arctan2(-read[:, 1], -read[:, 2])),
            "gravity_tilt_y [deg]": np.degrees(np.arctan2(read[:, 0], -read[:, 2])),
        }
    write_table(tmp_path / "data.csv", [HEADER, *more], q, np.zeros((10, 3)), *more.values())
    data = calib.read_measurements(tmp_path / "data.csv", robot)
    assert not data.ignored
    assert np.allclose(columns(robot, data.joints, data.conditions), torques(q, down), rtol=0, atol=1e-6)
    (tmp_path / "again.csv").write_text(calib.core.data.measurement_files.format_measurements(robot, data))
    again = calib.read_measurements(tmp_path / "again.csv", robot)
    assert np.allclose(columns(robot, q, again.conditions), torques(q, down), rtol=0, atol=1e-6)


def test_columns_count_only_where_the_description_speaks_of_gravity(tmp_path):
    robot, _ = arm(tmp_path)
    write_table(tmp_path / "data.csv", f"{HEADER},gravity_x", np.zeros((2, 6)), np.ones(2))
    assert calib.read_measurements(tmp_path / "data.csv", robot).ignored == ("gravity_x",)


def test_derivatives_by_the_direction_agree_with_central_differences(tmp_path):
    bending = "  - {joint: bend, term: bending}\n"
    robot = described(tmp_path, f"{{down: {DOWN.tolist()}, frame: fore, sigma: 10 deg}}", bending)
    assert [p.name for p in robot.parameters][-2:] == ["gravity.rx", "gravity.ry"]
    q = poses(robot, 6, 4)
    values = robot.values.copy()
    values[robot.coefficients] = [2e-4, 3e-4, 4e-4, 5e-4, 0.15, -0.2]
    bent = robot.with_parameters(values)
    read = replace(Context.neutral(6, 3), down=some_directions(6, 5))
    for context in (None, read):
        jacobian = assert_positions_move_as_differences_say(bent, q, context)
        assert np.abs(jacobian[..., -2:]).max(axis=(0, 1, 2)).min() > 1e-3


@pytest.mark.quick(0)
def test_a_direction_is_found_from_data_of_other_code(tmp_path):
    robot = described(tmp_path, "{sigma: 15 deg}", "sigma: 0.01 mm\n")
    down = unit(np.array([0.12, -0.2, -1.0]))  # 13 deg off
    rng = np.random.default_rng(6)
    q = rng.uniform(-1.2, 1.2, (80, 3))
    given = np.array([8e-5, 6e-5, 9e-5])
    measured = np.array([centres(row)[4] for row in q + given * torques(q, down)])
    measured += 1e-5 * rng.standard_normal(measured.shape)
    data = calib.as_measurements(robot, q, measured)
    fit = calib.fit(robot, data)
    assert fit.converged
    known = dict(zip(fit.free_names, fit.statistics.std, strict=True))
    (x, y), std = fit.robot.values[-2:], np.array([known["gravity.rx"], known["gravity.ry"]])
    result = Rotation.from_euler("XY", [x, y]).apply([0, 0, -1])
    assert np.linalg.norm(result - down) < 4 * np.linalg.norm(std) < 0.05
    assert fit.robot.values[robot.coefficients][:3] == pytest.approx(given, rel=0.1)
    fit.save(tmp_path / "out", pages=False)
    again = calib.load(tmp_path / "out")
    assert np.allclose(again.positions(q[:5]), fit.robot.positions(q[:5]), rtol=0, atol=1e-12)
    assert calib.fit(described(tmp_path, "{}", "sigma: 0.01 mm\n"), data).sigma > 2 * fit.sigma


@pytest.mark.parametrize("way", ["setups", "visits"])
def test_unseen_poses_are_predicted_with_the_direction_and_not_without(tmp_path, way):
    """By other code: a soft arm in three mountings, and on a base that tilts by up to 30 deg."""
    rng = np.random.default_rng(9)
    q, given, names = rng.uniform(-1.2, 1.2, (60, 3)), np.array([8e-5, 6e-5, 9e-5]), ["floor", "wall", "ceiling"] * 20
    mounted = {"floor": [0, 0, -1], "wall": [1, 0, 0], "ceiling": [0, 0, 1]}
    setups = "setups: {floor: [], wall: [], ceiling: []}\n" if way == "setups" else ""
    down = np.array([mounted[name] for name in names]) if setups else some_directions(60, 8)
    head, more = (f"{HEADER},setup", names) if setups else (f"{HEADER},gravity_x,gravity_y,gravity_z", down)
    points = np.array([centres(row)[4] for row in q + given * torques(q, down)])
    write_table(tmp_path / "data.csv", head, q, points + 1e-5 * rng.standard_normal((60, 3)), more)
    known = f"{ARM_YAML}{setups}gravity: {'{setups: {wall: [1, 0, 0], ceiling: [0, 0, 1]}}' if setups else '{}'}\n"
    stiff, off = ARM_YAML.replace("  - {joint: all, term: compliance}\n", "") + setups, []
    for yaml in (known, stiff):
        robot, _ = arm(tmp_path, yaml)
        data = calib.read_measurements(tmp_path / "data.csv", robot)
        fitted, unseen = calib.fit(robot, data[:40], sigma="0.01 mm").robot, data[40:]
        off.append(np.abs(fitted.positions(unseen.joints, unseen.conditions)[:, 0] - points[40:]).max())
    assert off[0] < 3e-5 < off[1] / 10  # three times the noise


def test_functions_in_other_languages_have_the_direction(tmp_path):
    robot = described(tmp_path, f"{{down: {DOWN.tolist()}, sigma: 10 deg}}")
    values = robot.values.copy()
    values[robot.coefficients] = [1e-3, 2e-3, 3e-3, 0.1, -0.2]
    bent = robot.with_parameters(values)
    made = exported(bent, "numpy", tmp_path)
    q = poses(robot, 5, 7)
    assert np.allclose(made.forward(q)[:, :3, 3], bent.positions(q)[:, 0], rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("gravity", "message"),
    [
        ("{down: [0, 0, 0]}", "gravity.down: a direction of gravity needs a length"),
        ("{down: [0, 0, .nan]}", r"gravity.down\[2\]: should be a finite number"),
        ("{frame: uper}", "gravity.frame: no link or joint 'uper'; did you mean 'upper'"),
        ("{setups: {wall: [1, 0, 0]}}", "gravity.setups: no setup 'wall'"),
        ("{sigma: 3 mm}", "gravity.sigma: unit 'mm' is for a length"),
        ("{down: [1.0e+308, 1.0e+308, 0]}", "gravity.down: a direction of gravity needs a length"),
        ("{sigma: 3}", "gravity.sigma: 172 deg means that nothing is known; write a unit, such as '3 deg'"),
    ],
)
def test_a_description_that_says_no_direction_is_refused(tmp_path, gravity, message):
    with pytest.raises(calib.DescriptionError, match=message):
        described(tmp_path, gravity)


VECTOR, TILTS = "gravity_x,gravity_y,gravity_z", "gravity_tilt_x,gravity_tilt_y"
UPWARDS = "accelerometer_x,accelerometer_y,accelerometer_z"


def with_columns(folder, gravity, head, cells):
    """Measurements of two visits with these columns."""
    robot = described(folder, gravity)
    rows = [f"0,0,{0.1 * k},0.9,0,0.5,{cell}" for k, cell in enumerate(cells)]
    (folder / "data.csv").write_text("\n".join([f"{HEADER},{head}", *rows]))
    return calib.read_measurements(folder / "data.csv", robot)


@pytest.mark.parametrize(
    ("gravity", "head", "cells", "message"),
    [
        (
            "{down: [0, 0, 1]}",
            VECTOR,
            ("0,0,-1", "0,0,-1"),
            "line 2: the direction of gravity that was read is 180 deg",
        ),
        ("{down: [0, 0, -1]}", VECTOR, ("0,0,-1", "1,0,0"), "line 3: the direction of gravity that was read is 90 deg"),
        ("{down: [0, 0, 1], frame: upper}", VECTOR, ("0,0,-1", "0,0,-1"), "line 2: .* 180 deg from"),
        ("{down: [0, 0, 1], sigma: 20 deg}", VECTOR, ("0,0,1", "1,0,0"), "line 3: .* 90 deg from"),
        ("{}", VECTOR, ("0,0,-1", ",,"), "line 3: a cell of gravity_x"),
        ("{}", VECTOR, ("0,0,0", "0,0,0"), "line 2: gravity is 0 long"),
        ("{}", VECTOR, ("0,0,-9.8", "0,0,-0.98"), "line [23]: gravity is"),
        ("{}", "gravity_x,gravity_y", ("0,0", "0,0"), "no column 'gravity_z'; gravity's direction needs gravity_x"),
        ("{}", "gravity_x,gravity_y,gravity_Z", ("0,0,-1", "0,0,-1"), "no column 'gravity_z'; gravity's direction"),
        ("{}", "acelerometer_x,acelerometer_y,z", ("0,0,1", "0,0,1"), "did you mean 'accelerometer_x'"),
        ("{}", TILTS, ("0,12", "0,11"), "beyond 85 deg.*Without .deg. in its header a column is"),
        (
            "{}",
            f"{TILTS},{UPWARDS}",
            ("0,0,0,0,1", "0,0,0,0,1"),
            "'accelerometer_x' and 'gravity_tilt_x' both say where",
        ),
    ],
)
def test_columns_that_say_no_direction_or_contradict_the_one_that_is_stated(tmp_path, gravity, head, cells, message):
    with pytest.raises(calib.DataError, match=message):
        with_columns(tmp_path, gravity, head, cells)


@pytest.mark.parametrize(
    ("gravity", "downs"),
    [
        ("{}", ("0,0,1", "1,0,0")),  # nothing is stated
        ("{down: [0, 0, 1]}", ("0,0,1", "0.5,0,0.866")),  # the base tilts by 30 degrees
        ("{down: [0, 0, 1], sigma: 20 deg}", ("0,0,1", "0.766,0,0.643")),  # 50 degrees are less than three sigma
    ],
)
def test_a_sensor_may_read_what_the_description_leaves_open(tmp_path, gravity, downs):
    assert len(with_columns(tmp_path, gravity, VECTOR, downs)) == 2


def test_of_two_files_both_say_where_gravity_points_or_none(tmp_path):
    robot = described(tmp_path, "{}")
    write_table(tmp_path / "one.csv", f"{HEADER},gravity_x,gravity_y,gravity_z", np.zeros((2, 6)), [[0, 0, -1]] * 2)
    write_table(tmp_path / "two.csv", HEADER, np.zeros((2, 6)))
    with pytest.raises(calib.DataError, match=r"two\.csv: has no column 'gravity_x', but another file has it"):
        calib.read_measurements([tmp_path / "one.csv", tmp_path / "two.csv"], robot)


LINKS = ("ground", "ground_x", "tracks", "carriage", "carriage_x", "head", "tool", "rod")
MAST = (
    '<robot name="mast">\n'
    + "".join(f'<link name="{name}"/>' for name in LINKS)
    + joint("tip_x", "ground", "ground_x", "0 0 0", "1 0 0", limits=(-0.2, 0.2))
    + joint("tip_y", "ground_x", "tracks", "0 0 0", "0 1 0", limits=(-0.2, 0.2))
    + joint("lift", "tracks", "carriage", "0.5 0 0.2", "0 0 1", "prismatic", (0, 3))
    + joint("lean_x", "carriage", "carriage_x", "0 0 0", "1 0 0", limits=(-0.2, 0.2))
    + joint("lean_y", "carriage_x", "head", "0 0 0", "0 1 0", limits=(-0.2, 0.2))
    + joint("turn", "head", "tool", "0 0 0", "0 0 1")
    + joint("slide", "tool", "rod", "0 0 0", "1 0 0", "prismatic", (-0.5, 0.5))
    + "</robot>\n"
)
MAST_YAML = """\
urdf: mast.urdf
name_mot: [tip_x, tip_y, lift, lean_x, lean_y, turn, slide]
base: {frame: ground}
targets: {ball: {frame: rod, xyz: [0.8, 0, 0]}}
parametrisation:
  - {origin: turn, components: [x, y], sigma: 1 mm}
"""
SENSORS = """\
inclinometers:
  low: {frame: tracks, joints: [tip_x, tip_y]}
  high: {frame: head, joints: [lean_x, lean_y]}
"""
LIFT_HEADER = "lift [m],turn [rad],slide [m],ball_x [m],ball_y [m],ball_z [m]"


def mast(folder, more=SENSORS, urdf=MAST):
    (folder / "mast.urdf").write_text(urdf)
    (folder / "mast.yaml").write_text(MAST_YAML + more)
    return calib.load(folder / "mast.yaml")


def leaning(n, seed):
    """Joints of the mast with its rod, where its ball is and what its accelerometers read, by rotations of scipy."""
    rng = np.random.default_rng(seed)
    q = rng.uniform([-0.1, -0.1, 0, -0.1, -0.1, -3, -0.4], [0.1, 0.1, 3, 0.1, 0.1, 3, 0.4], (n, 7))
    zero = np.zeros(n)
    tracks = Rotation.from_euler("XY", q[:, :2])
    head = tracks * Rotation.from_euler("XY", q[:, 3:5])
    rod = (head * Rotation.from_euler("Z", q[:, [5]])).apply(np.column_stack([0.8 + q[:, 6], zero, zero]))
    points = tracks.apply(np.column_stack([zero + 0.5, zero, 0.2 + q[:, 2]])) + rod
    return q, points, *(G * link.inv().apply([0, 0, 1]) for link in (tracks, head))


@pytest.mark.parametrize("way", ["accelerometer", "gravity_tilt"])
def test_joints_that_nobody_commands_are_read_by_inclinometers(tmp_path, way):
    robot = mast(tmp_path)
    q, points, low, high = leaning(8, 8)
    head, cells = LIFT_HEADER, [q[:, 2], q[:, 5], q[:, 6], points]
    for name, read in (("low", low), ("high", high)):
        head += "".join(f",{name}_{way}_{axis}" for axis in "xyz"[: 3 if way == "accelerometer" else 2])
        tilts = [np.arctan2(read[:, 1], read[:, 2]), np.arctan2(-read[:, 0], read[:, 2])]
        cells += [read] if way == "accelerometer" else tilts
    write_table(tmp_path / "data.csv", head, *cells)
    data = calib.read_measurements(tmp_path / "data.csv", robot)
    assert not data.ignored
    assert np.allclose(data.joints, q, rtol=0, atol=1e-10)
    assert np.allclose(robot.positions(data.joints)[:, 0], points, rtol=0, atol=1e-9)
    (tmp_path / "again.csv").write_text(calib.core.data.measurement_files.format_measurements(robot, data))
    again = calib.read_measurements(tmp_path / "again.csv", robot)  # joint values stand in that file
    assert np.allclose(again.joints, q, rtol=0, atol=1e-10)


def test_foreign_columns_may_be_what_an_inclinometer_reads(tmp_path):
    columns = "columns: {imu_x: low_accelerometer_x, imu_y: low_accelerometer_y, imu_z: low_accelerometer_z}\n"
    robot = mast(tmp_path, SENSORS.replace("  high: {frame: head, joints: [lean_x, lean_y]}\n", columns))
    (tmp_path / "data.csv").write_text(f"{LIFT_HEADER},lean_x,lean_y,imu_x,imu_y,imu_z\n1,0,0,1,0,1,0,0,0,0,9.8\n")
    assert np.allclose(calib.read_measurements(tmp_path / "data.csv", robot).joints, [[0, 0, 1, 0, 0, 0, 0]])


def reading(low, high):
    """Columns of the accelerometers."""
    names = [f"{sensor}_accelerometer_{axis}" for sensor in ("low", "high") for axis in "xyz"]
    return dict(zip(names, np.hstack([low, high]).T, strict=True))


def written(path, columns):
    return write_table(path, columns, *columns.values())


def test_goals_are_reached_as_the_robot_stands(tmp_path, run_calib):
    robot = mast(tmp_path)
    q, points, low, high = leaning(6, 11)
    goals = {f"ball_{axis} [m]": values for axis, values in zip("xyz", points.T, strict=True)}
    file = written(tmp_path / "goals.csv", goals | reading(low, high))
    run = run_calib("solve", tmp_path / "mast.yaml", file, "--out", tmp_path / "solved.csv")
    assert run.code == 0, run.err
    assert np.allclose(calib.read_poses(tmp_path / "solved.csv", robot).joints, q, rtol=0, atol=1e-8)
    stands = {name: q[:, k] for k, name in enumerate(robot.joint_names) if name in robot.sensed_names}
    assert np.allclose(calib.solve(robot, calib.Goals(points, stands=stands)).q, q, rtol=0, atol=1e-8)
    level = calib.solve(robot, calib.Goals(points[:1], stands=dict.fromkeys(robot.sensed_names, 0.0)))
    assert np.linalg.norm(level.q[0] - q[0]) > 0.01
    assert np.all(level.q[0][[0, 1, 3, 4]] == 0)


def test_a_program_is_compensated_as_the_robot_stands(tmp_path):
    robot = mast(tmp_path)
    q, points, low, high = leaning(6, 12)
    told = {name: q[:, k] for k, name in enumerate(robot.joint_names) if name in robot.commanded_names}
    program = calib.read_poses(written(tmp_path / "program.csv", told | reading(low, high)), robot)
    true = robot.with_parameters({"turn.x": 2e-3, "turn.y": -1e-3})
    result = calib.compensate(true, program, keep="position")
    assert not result.unreached_rows()
    assert np.allclose(true.positions(result.q)[:, 0], points, rtol=0, atol=1e-9)
    assert np.allclose(result.q[:, [0, 1, 3, 4]], q[:, [0, 1, 3, 4]], rtol=0, atol=1e-12)
    stands = {name: q[:, robot.joint_names.index(name)] for name in robot.sensed_names}
    again = calib.compensate(true, calib.Goals(points, stands=stands))
    assert np.allclose(again.q, result.q, rtol=0, atol=1e-8)


def test_goals_in_a_setup_have_its_gravity(tmp_path, run_calib):
    setups = "base: {frame: base}\nsetups: {floor: [], wall: []}\ngravity: {setups: {wall: [2, 0, 0]}}\n"
    robot, _ = arm(tmp_path, ARM_YAML.replace("base: {frame: base}\n", setups))
    robot = robot.with_parameters({"lift.compliance": 3e-4, "bend.compliance": 2e-4})
    q = poses(robot, 4, 13)
    points = []
    for row, down in zip(q, ([0, 0, -1], [1, 0, 0], [0, 0, -1], [1, 0, 0]), strict=True):
        points.append(centres(row + np.array([0, 3e-4, 2e-4]) * torques(row[None], np.array(down, dtype=float))[0])[4])
    goals = calib.Goals(np.array(points), setups=np.array([0, 1, 0, 1]))
    solution = calib.solve(robot, goals, near=q)
    assert np.allclose(solution.q, q, rtol=0, atol=1e-6)
    assert np.abs(calib.solve(robot, calib.Goals(np.array(points)), near=q).q - q)[1::2].max() > 1e-4
    (tmp_path / "goals.csv").write_text("ball_x [m],ball_y [m],ball_z [m],setup\n0.6,0,0.4,wall\n0.6,0,0.4,ceiling\n")
    run = run_calib("solve", tmp_path / "arm.yaml", tmp_path / "goals.csv", "--out", tmp_path / "solved.csv")
    assert "line 3, column 'setup': no setup 'ceiling'" in run.refusal()


def test_goals_that_do_not_say_how_the_robot_stands_are_refused(tmp_path, run_calib):
    mast(tmp_path)

    def solving(columns):
        goals = {f"ball_{axis} [m]": [value] for axis, value in zip("xyz", (1.2, 0.1, 1.0), strict=True)}
        file = written(tmp_path / "goals.csv", goals | columns)
        return run_calib("solve", tmp_path / "mast.yaml", file, "--out", tmp_path / "solved.csv").refusal()

    assert "no column 'lean_x', and none of inclinometer 'high' for this joint: expected high_accelerometer_x" in (
        solving({"tip_x": [0], "tip_y": [0]})
    )
    (tmp_path / "mast.urdf").write_text(MAST.replace('name="lift" type="prismatic"', 'name="lift" type="revolute"'))
    assert "what 'high' reads depends on joint 'lift', which is to be found; give columns" in (
        solving(reading(np.array([[0, 0, G]]), np.array([[0, 0, G]])))
    )
    assert not (tmp_path / "solved.csv").exists()


def test_nobody_can_command_what_inclinometers_read(tmp_path):
    with pytest.raises(
        calib.InputError, match=r"inclinometers read tip_x, .*, so these are not commanded; give their values"
    ):
        calib.solve(mast(tmp_path), np.array([[1.0, 0.0, 1.0]]))
    with pytest.raises(calib.DataError, match="stands of 'tip_x' must be one number"):
        calib.Goals(np.zeros((2, 3)), stands={"tip_x": [0.0, np.nan]})


@pytest.mark.parametrize(
    ("low", "message"),
    [
        ("{frame: track, joints: [tip_x, tip_y]}", "inclinometers.low.frame: no link or joint 'track'; did you mean"),
        ("{frame: tracks, joints: [tip_x, tip_z]}", "inclinometers.low.joints: no joint 'tip_z' in name_mot"),
        ("{frame: tracks, joints: [tip_x, tip_x]}", "'tip_x' is read by 'low' already"),
        ("{frame: carriage, joints: [tip_x, lift]}", "'lift' slides, and tilts nothing"),
        ("{frame: tracks, joints: [tip_x, turn]}", "'turn' does not move tracks"),
        ("{frame: tool, joints: [tip_x, tip_y]}", "list 'high' before 'low': it moves 'low'"),
        ("{frame: ground, joints: [tip_x, tip_y]}", "'tip_x' does not move ground"),
    ],
)
def test_an_inclinometer_that_says_nothing_of_its_joints_is_refused(tmp_path, low, message):
    with pytest.raises(calib.DescriptionError, match=message):
        mast(tmp_path, SENSORS.replace("{frame: tracks, joints: [tip_x, tip_y]}", low))


LEAN = "lean_x,lean_y"
UP = f"{LEAN},{','.join(f'low_accelerometer_{axis}' for axis in 'xyz')}"
HIGH = "tip_x,tip_y,high_gravity_tilt_x,high_gravity_tilt_y"


@pytest.mark.parametrize(
    ("head", "cells", "message"),
    [
        (UP, "0,0,0,0,-9.8", "tip_x and tip_y have no values at which 'low' reads this"),
        (UP, "0,0,0.1,0.05,-9.8", "what 'low' reads turns tip_x by .*; check signs"),
        (UP, "0,0,9.8,0,0", "tip_x and tip_y have no values at which 'low' reads this"),
        (UP.replace("accelerometer", "gravity"), "0,0,0.1,0.05,9.8", "'low' reads turns tip_x by"),
        (UP, "0,0,0,0,0", "low_accelerometer is 0 long"),
        (f"{UP},low_gravity_x", "0,0,0,0,9.8,0", "'low_gravity_x' and 'low_accelerometer_x' both say"),
        (HIGH, "0,0,0.3,0.4", "turns lean_x by 15.90 deg.*units .rad without"),
        (f"{LEAN},{UPWARDS}", "0,0,0,0,9.8", "none of inclinometer 'low'"),
        (LEAN, "0,0", "no column 'tip_x', and none of inclinometer 'low' for this joint: expected low_accelerometer_x"),
        ("tip_x,low_gravity_tilt_x", "0,0", "column 'tip_x' and inclinometer 'low' give the same joint"),
        ("tip_x,tip_y,high_gravity_tilt_x", "0,0,0", "no column 'high_gravity_tilt_y'"),
        (HIGH, "0,0,0,", "line 2: a cell of high_gravity_t"),
        (HIGH, "0,0,0,1.54", "high_gravity_tilt is a tilt beyond"),
    ],
)
def test_a_file_in_which_inclinometers_say_too_little_is_refused(tmp_path, head, cells, message):
    robot = mast(tmp_path)
    (tmp_path / "data.csv").write_text(f"{LIFT_HEADER},{head}\n1,0,0,1,0,1,{cells}\n")
    with pytest.raises(calib.DataError, match=message):
        calib.read_measurements(tmp_path / "data.csv", robot)


def test_two_joints_about_one_axis_cannot_be_told_apart(tmp_path):
    robot = mast(tmp_path, urdf=MAST.replace("0 1 0", "1 0 0", 1))
    (tmp_path / "data.csv").write_text(f"{LIFT_HEADER},{UP}\n1,0,0,1,0,1,0,0,1,0,9.8\n")
    with pytest.raises(calib.DataError, match="line 2: tip_x and tip_y have no values at which 'low' reads this"):
        calib.read_measurements(tmp_path / "data.csv", robot)
