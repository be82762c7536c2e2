"""Numbers that mean something else than they were read as: rotations in another order, lengths in another unit."""

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib
from calib.core.judging.row_derivatives import length_derivative
from calib.core.rows.observed import observe, predict_readings
from tests.core.instruments.test_kind_pose import YAML as POSES
from tests.project import EXAMPLES, copied, write_table
from tests.six_axis_arm import joints, measurements, write_six_axis
from tests.urdf_trees import urdf_of

ORDERS = {
    "of inverse rotations": lambda q: (q * [-1, -1, -1, 1])[:, [3, 0, 1, 2]],
    "were inverse": lambda q: q * [-1, -1, -1, 1],
    "look at their order, form, unit and frame": lambda q: q[:, [2, 1, 0, 3]],
}
"""What is said, and the order in which quaternions are read; beside `qw qx qy qz`, the situation of `misread`."""


@pytest.fixture(scope="module")
def poses(tmp_path_factory):
    """An arm read by a pose sensor, 40 joint values, and where the sensor was: with noise, in a base somewhere."""
    robot = calib.load(write_six_axis(tmp_path_factory.mktemp("arm"), POSES))
    q, rng = joints(40), np.random.default_rng(3)
    T = robot.forward(q, "l6") @ np.block([[np.eye(3), np.array([[0.052], [0.02], [0.1]])], [0, 0, 0, 1]])
    base = Rotation.from_rotvec([0.3, -0.4, 1.0])
    points = base.apply(T[:, :3, 3]) + [0.5, -1.0, 0.2] + 2e-5 * rng.standard_normal((40, 3))
    turns = base * Rotation.from_matrix(T[:, :3, :3]) * Rotation.from_rotvec([0.01, 0.0, -0.02])
    return robot, q, points, Rotation.from_rotvec(5e-5 * rng.standard_normal((40, 3))) * turns


def scale_named(verdict, what):
    """How much larger things are by the first reason that names a scale of them [%]."""
    text = next(reason.text for reason in verdict.reasons if reason.code in ("lengths_scaled", "misread"))
    match = re.match(rf"{what} ([\d.]+) % (longer|larger|shorter|smaller)", text)
    return float(match[1]) * (1 if match[2] in ("longer", "larger") else -1)


def read(folder, robot, q, points, numbers, columns="qx qy qz qw"):
    """Measurements from a file with these columns of rotations."""
    head = [*(f"j{k} [rad]" for k in range(1, 7)), *(f"tracker_{a} [m]" for a in "xyz")]
    head += [f"tracker_{name}" for name in columns.split()]
    return calib.read_measurements(write_table(folder / "data.csv", head, q, points, numbers), robot)


@pytest.mark.quick(0)
@pytest.mark.parametrize("order", ORDERS)
def test_quaternions_in_another_order_fail_and_the_order_is_named(poses, tmp_path, order):
    robot, q, points, turns = poses
    fit = calib.fit(robot, read(tmp_path, robot, q, points, ORDERS[order](turns.as_quat())))
    assert (fit.verdict.grade, fit.verdict.to_dict()["codes"][0]) == ("FAIL", "misread")
    assert order in fit.verdict.reasons[0].text


def test_angles_of_another_form_are_named(tmp_path, poses):
    _, q, points, turns = poses
    robot = calib.load(write_six_axis(tmp_path, POSES.replace("kind: pose,", "kind: pose, rotation: intrinsic_xyz,")))
    data = read(tmp_path, robot, q, points, turns.as_euler("xyz"), "rx ry rz")
    text = calib.fit(robot, data).verdict.reasons[0].text
    assert "its angles were of the form rpy" in text


@pytest.mark.quick(0)
@pytest.mark.parametrize("scale", [0.984, 1.016])
def test_lengths_of_another_unit_fail_without_priors_too(arm, scale):
    """1.6 % is what a fortieth of a metre lacks to an inch; with priors it is the situation of `lengths_scaled`."""
    rng, free = np.random.default_rng(5), arm.is_free
    values = arm.values + 0.5 * free * rng.standard_normal(len(free)) * [p.sigma_si for p in arm.parameters]
    points = arm.with_parameters(values).positions(joints(60))
    fit = calib.fit(arm, measurements(arm, joints(60), scale * points + 4e-5 * rng.standard_normal(points.shape)))
    assert fit.verdict.grade == "FAIL"
    assert scale_named(fit.verdict, "all measured lengths are") == pytest.approx(100 * (scale - 1), abs=0.3)


@pytest.mark.quick(1)
@pytest.mark.parametrize(("axis", "scale"), [("x", 1.02), ("y", 0.98), ("z", 1.005)])
def test_lengths_on_another_scale_along_one_axis_are_named_without_a_stated_noise(axis, scale, tmp_path):
    """Joint origins take much of it up, and the rest may pass for noise where none is stated."""
    robot = calib.load(copied(tmp_path, EXAMPLES / "arm.yaml", ("\nsigma: 0.03 mm", "")))
    data = calib.read_measurements(EXAMPLES / "arm_simulated.csv", robot)
    points = data.points(robot)[:, 0] * np.where(np.array(list("xyz")) == axis, scale, 1.0)
    verdict = calib.fit(robot, calib.as_measurements(robot, data.joints, points)).verdict
    assert verdict.grade == "FAIL"
    assert scale_named(verdict, f"measured lengths along {axis} are") == pytest.approx(100 * (scale - 1), rel=0.1)


@pytest.mark.quick(3)
@pytest.mark.parametrize(
    ("form", "scale", "noise"),
    [
        ("rotation_vector", 0.98, 5e-5),
        ("rpy", 1.005, 5e-5),
        ("quaternion", 1.02, 2e-3),
        ("quaternion", 1.0, 2e-3),
        ("rotation_vector", 1.02, 2e-3),
        ("intrinsic_zyx", 0.98, 2e-3),
        ("intrinsic_xyz", 1.001, 2e-3),
        ("rpy", 1.0, 2e-3),
        ("rpy", 0.8, 2e-3),
    ],
)
def test_angles_of_orientations_on_another_scale_are_named_without_a_stated_noise(tmp_path, form, scale, noise):
    """Positions fit as before; only the noise that is found of orientations grows, and none is stated."""
    robot = calib.load(write_six_axis(tmp_path, POSES.replace("target: cell}", f"target: cell, rotation: {form}}}")))
    q, rng = 0.6 * joints(60), np.random.default_rng(5)
    T = robot.forward(q, "cell")
    turns = Rotation.from_rotvec(noise * rng.standard_normal((60, 3))) * Rotation.from_matrix(T[:, :3, :3])
    sequence = {"rpy": "xyz", "intrinsic_xyz": "XYZ", "intrinsic_zyx": "ZYX"}.get(form)
    if sequence is None:
        turns = Rotation.from_rotvec(scale * turns.as_rotvec())
    else:
        turns = Rotation.from_euler(sequence, scale * turns.as_euler(sequence))
    read = np.hstack([T[:, :3, 3] + 3e-5 * rng.standard_normal((60, 3)), turns.as_rotvec()])
    verdict = calib.fit(robot, calib.as_measurements(robot, q, {"tracker": read})).verdict
    if abs(scale - 1.0) < 2e-3:
        assert verdict.grade == "PASS"
        return
    assert verdict.grade == "FAIL"
    if scale < 0.9:  # too far off for a derivative: no factor is named
        assert [reason.code for reason in verdict.reasons if reason.grade == "FAIL"] == ["misread"]
        return
    assert scale_named(verdict, "angles of tracker are") == pytest.approx(100 * (scale - 1), rel=0.2)


@pytest.mark.quick(2)
@pytest.mark.parametrize(("scale", "grade"), [(1.03, "CHECK"), (0.97, "CHECK"), (1.0, "PASS"), (1.01, "PASS")])
def test_links_that_are_known_loosely_say_from_which_scale_on_lengths_are_doubted(tmp_path, run_calib, scale, grade):
    """Seven joints whose links are known to 2 mm: lengths 1 % too long move none of them by two of these sigmas."""
    given = ("init", "--dh", EXAMPLES / "panda_dh.csv", "--measure", "tracker", "--out", tmp_path / "robot.yaml")
    assert run_calib(*given).code == 0
    robot, rng = calib.load(tmp_path / "robot.yaml"), np.random.default_rng(11)
    own = robot.parameters[: robot.n_origin_parameters]
    errors = {p.name: p.nominal_si + 0.3 * p.sigma_si * rng.normal() for p in own if not p.placement}
    q = calib.sample(robot, 70, np.random.default_rng(2)).joints
    points = scale * (robot.with_parameters(errors).positions(q)[:, 0] + 3e-5 * rng.standard_normal((70, 3)))
    verdict = calib.fit(robot, calib.as_measurements(robot, q, points)).verdict
    assert verdict.grade == grade
    line = next(line for line in verdict.not_covered if line.startswith("a scale error"))
    assert 10 < float(re.match(r"a scale error below ([\d.]+) mm in 1 m", line)[1]) < 30
    assert ("lengths_scaled" in [reason.code for reason in verdict.reasons]) == (grade == "CHECK")


ENDS = {"left": [1, 0.8, 0.2], "right": [1, -0.9, 0.3], "above": [0.3, 0.1, 1.6]}
BAR = "  {}: {{kind: distance, target: reflector, end: {{frame: base_link, position: unknown, xyz: {}}}}}\n"


@pytest.mark.quick(2)
@pytest.mark.parametrize(
    ("wrong", "scale", "offset", "grade", "words"),
    [
        (("right",), 1.02, 0.0, "FAIL", r"readings of right are 2 % longer"),
        (("left",), 1.0, 10e-3, "CHECK", r"readings of left are off by \+(9.[5-9]|10.[0-4])\d* mm"),
        ((), 1.0, 0.0, "PASS", r"^"),
        (("left",), 1.001, 0.0, "CHECK", r"readings of left are \+(99\d|100\d) ppm too large"),
        (ENDS, 1.01, 0.0, "CHECK", r"all measured lengths are (1|0.9\d) % longer"),
        (ENDS, 1.0, 10e-3, "CHECK", r"readings of (left|right|above) are off by"),
    ],
)
def test_a_ballbar_that_reads_wrong_is_no_noise(tmp_path, wrong, scale, offset, grade, words):
    """No noise is stated: a wrong bar would be weighed down, by the noise that is found of it."""
    robot = described(tmp_path, "".join(BAR.format(*end) for end in ENDS.items()), turned="")
    rng = np.random.default_rng(7)
    values = {p.name: p.nominal_si + 0.7 * p.sigma_si * rng.normal() for p in robot.parameters if not p.placement}
    q = rng.uniform(*np.radians([[-80, -40, -10, -120, -90, -170], [80, 80, 100, 120, 90, 170]]), (80, 6))
    true = robot.with_parameters({name: values[name] for name in values if name.startswith("joint")})
    points = true.positions(q)[:, 0]
    bars = {name: np.linalg.norm(points - end, axis=1) + 1e-5 * rng.standard_normal(80) for name, end in ENDS.items()}
    read = {name: (scale * bar + offset if name in wrong else bar)[:, None] for name, bar in bars.items()}
    verdict = calib.fit(robot, calib.as_measurements(robot, q, read)).verdict
    assert verdict.grade == grade, verdict
    assert re.search(words, "; ".join(reason.text for reason in verdict.reasons if reason.grade == grade))


@pytest.mark.quick(0)
def test_inches_read_as_millimetres_are_told_as_a_factor(robot, data):
    """In percent, lengths 25.4 times too short would be 2440 % shorter, which nothing is."""
    fit = calib.fit(robot, calib.as_measurements(robot, data.joints, data.points(robot)[:, 0] / 25.4))
    text = next(reason.text for reason in fit.verdict.reasons if reason.code == "lengths_scaled")
    factor = re.match(r"all measured lengths are ([\d.]+) times as long as in the description", text)
    assert factor
    assert float(factor[1]) == pytest.approx(1 / 25.4, rel=0.1)


@pytest.mark.quick(0)
def test_gears_that_turn_too_far_are_no_lengths_of_another_unit(robot, data):
    """Larger arcs look like longer links: a gain of 1 % of all joints, which the model lacks, like lengths 1 % off."""
    middle = np.mean(data.joints, axis=0)
    points = calib.fit(robot, data).robot.positions(middle + 1.01 * (data.joints - middle))
    fit = calib.fit(robot, calib.as_measurements(robot, data.joints, points))
    assert "lengths_scaled" not in fit.verdict.to_dict()["codes"]
    assert fit.sigma > 1e-4  # which is not what the instrument leaves


def test_a_robot_whose_only_length_is_free_is_not_scaled(tmp_path):
    """A positioner with two axes that meet: its table could shrink to a point, and explain everything."""
    up, turned = '<axis xyz="0 0 1"/>', '<origin rpy="-1.5708 0 -1.5708"/>'
    table = ("j2", "revolute", "l1", "l2", turned + up)
    (tmp_path / "robot.urdf").write_text(urdf_of(("j1", "revolute", "l0", "l1", up), table))
    (tmp_path / "robot.yaml").write_text(
        "urdf: robot.urdf\nname_mot: [j1, j2]\nbase: {frame: l0, pose: unknown}\n"
        "targets: {ball: {frame: l2, position: unknown}}\n"
        "parametrisation:\n  - {origin: all, components: [x, y, z], sigma: 2 mm}\n"
        "  - {origin: all, components: [rx, ry, rz], sigma: 5 mrad}\n"
    )
    robot = calib.load(tmp_path / "robot.yaml")
    rng = np.random.default_rng(4)
    q = rng.uniform(-2.5, 2.5, (80, 2))
    free = robot.is_free & ~np.array([parameter.placement for parameter in robot.parameters])
    sigma = np.array([parameter.sigma_si for parameter in robot.parameters])
    true = robot.with_parameters(robot.values + 0.5 * free * sigma * rng.standard_normal(len(sigma)))
    placed = true.with_parameters({"ball.x": 0.5, "ball.y": 0.2, "base.x": 2.0, "base.rz": 1.5})
    points = placed.positions(q) + 2e-4 * rng.standard_normal((80, 1, 3))
    fit = calib.fit(robot, measurements(robot, q, points))
    assert "lengths_scaled" not in fit.verdict.to_dict()["codes"]
    assert fit.verdict.grade == "PASS"


BOARD = """\
  ahead: {kind: pixel, target: reflector, points: {a: [0, 0, 0], b: [B mm, 0, 0], c: [0, C mm, 0]}, CAMERA,
    intrinsics: {fx: 3000, fy: 3000, cx: 2000, cy: 1500}, NOISE: 0.05}
""".replace("CAMERA", "camera: {frame: base_link, xyz: [3, 0, 0.5], rpy: [-90 deg, 0, 90 deg], pose: unknown}")
ARTEFACT = """\
  probe: {kind: touch, target: reflector, NOISE: 0.03 mm, artefact: {frame: base_link, xyz: [0.5, 0, 0.3],
    pose: unknown, sigma: 5 mm, sigma_angle: 20 mrad, points: {a: [0, 0, 0], b: [B mm, 0, 0], c: [0, C mm, 0]}}}
"""


def described(folder, entries, noise=True, size=1.0, turned=", orientation: unknown, sigma_angle: 50 mrad"):
    """The example's arm with other instruments, whose artefact is this many times as large."""
    text = (EXAMPLES / "arm.yaml").read_text().replace("arm.urdf", str(EXAMPLES / "arm.urdf"))
    head, rest = text.split("base: ")[0], text.split("parametrisation:\n")[1].replace("sigma: 0.03 mm", "")
    entries = re.sub(r"\bB mm", f"{200 * size} mm", entries).replace("C mm", f"{150 * size} mm")
    entries = entries.replace("NOISE", "sigma") if noise else re.sub(r", NOISE: [.0-9]+( mm)?", "", entries)
    target = "{frame: flange, xyz: [20 mm, 30 mm, 50 mm], position: unknown, sigma: 5 mm"
    places = f"base: {{frame: base_link}}\ntargets: {{reflector: {target}{'' if 'touch' in entries else turned}}}}}\n"
    (folder / "robot.yaml").write_text(f"{head}{places}instruments:\n{entries}parametrisation:\n{rest}")
    return calib.load(folder / "robot.yaml")


@pytest.mark.quick(2)
@pytest.mark.parametrize("noise", [True, False])
@pytest.mark.parametrize(
    ("entries", "size"), [(entries, size) for size in (1.02, 0.98, 1.001, 1.0) for entries in (BOARD, ARTEFACT)]
)
def test_a_board_or_an_artefact_of_another_size_is_named(tmp_path, entries, size, noise):
    """Joint origins, all of which are free, take nearly all of it up, and no noise shows it."""
    robot, rng = described(tmp_path, entries, noise=noise), np.random.default_rng(7)
    own = robot.parameters[: robot.n_origin_parameters]
    errors = {p.name: p.nominal_si + 0.7 * p.sigma_si * rng.normal() for p in own if p.name.startswith("joint")}
    true = described(tmp_path, entries, size=size).with_parameters(errors)
    poses = joints(60) if entries is BOARD else calib.sample(true, 60, np.random.default_rng(2))
    verdict = calib.fit(robot, calib.simulate(true, poses, seed=np.random.default_rng(3))).verdict
    is_off = abs(size - 1) > 0.01
    assert verdict.grade == ("FAIL" if is_off else "PASS"), verdict
    if is_off:
        assert verdict.reasons[0].code == "lengths_scaled"
        assert scale_named(verdict, "all measured lengths are") == pytest.approx(100 * (1 - size), abs=0.4)


@pytest.mark.parametrize(
    "entry",
    [
        BOARD,
        ARTEFACT,
        ARTEFACT.replace("NOISE", "surface: sphere, radius: 10 mm, NOISE").replace("points:", "radius: 30 mm, points:"),
        "  table: {kind: touch, target: reflector, surface: plane, radius: 10 mm, places: {flat: {frame: base_link,"
        " xyz: [0, 0, 0.3], rpy: [0.1, 0.2, 0], position: unknown}}}\n",
        "  tracker: {kind: pose, target: reflector}\n",
        "  tracker: {kind: position, target: reflector}\n",
        "  bar: {kind: distance, target: reflector, end: {frame: base_link, xyz: [1, 0.8, 0.2], position: unknown}}\n",
    ],
)
def test_readings_of_a_robot_of_another_size_change_as_said(tmp_path, entry):
    """All lengths of the robot, its places and targets grow; the artefact stays."""
    robot, q, step = described(tmp_path, entry), joints(5), 1e-6
    readings = predict_readings(robot, robot.assemble(q))
    own = [robot.unknowns[name] for name in readings]
    numbers = {k for of in own for k in np.arange(len(robot.values))[of].tolist()}
    grows = [p.dimension == "length" and k not in numbers for k, p in enumerate(robot.parameters)]
    larger, smaller = (robot.with_parameters(robot.values * (1 + sign * step * np.array(grows))) for sign in (1, -1))
    more, less = (observe(of, of.assemble(q), readings) for of in (larger, smaller))
    for name, columns in length_derivative(robot, robot.assemble(q), readings).items():
        expected = (more[name].residuals - less[name].residuals) / (2 * step)
        assert np.any(expected)
        np.testing.assert_allclose(columns, expected, atol=1e-7 * np.abs(expected).max())


def test_lengths_of_a_turntable_are_not_doubted(tmp_path):
    """The place of the reflector is hardly known, so any radius will do, and noise is all that could show a scale."""
    joint = '<joint name="turn" type="revolute"><parent link="base"/><child link="plate"/><axis xyz="0 0 1"/>'
    limit = '<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
    urdf = f'<robot name="table"><link name="base"/><link name="plate"/>{joint}{limit}</robot>'
    (tmp_path / "table.urdf").write_text(urdf)
    places = "base: {frame: base, pose: unknown}\ntargets: {ball: {frame: plate, position: unknown, sigma: 50 mm}}\n"
    origins = "parametrisation: [{origin: all, components: [x, y, z], sigma: 1 mm}]\n"
    (tmp_path / "table.yaml").write_text(f"urdf: table.urdf\nname_mot: [turn]\n{places}{origins}")
    robot, rng = calib.load(tmp_path / "table.yaml"), np.random.default_rng(0)
    q = rng.uniform(-2.7, 2.7, (60, 1))
    turning = np.column_stack([np.cos(q[:, 0]), np.sin(q[:, 0]), np.zeros(60)])
    points = np.array([2.0, -1.0, 0.9]) + 0.036 * turning + 3e-5 * rng.standard_normal((60, 3))
    verdict = calib.fit(robot, calib.as_measurements(robot, q, points)).verdict
    assert not any("lengths are" in reason.text for reason in verdict.reasons)
    assert verdict.grade != "FAIL"
