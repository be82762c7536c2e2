"""Simulated measurements: the truth plus normal noise, the same again from the same seed, and said so in the file."""

from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.core.base.errors import DataError
from calib.core.data.plan_files import read_plan
from calib.core.data.tables import read_table
from tests.core.instruments.test_kind_pixel import FREE, INTRINSICS, POINTS
from tests.kind_checks import brought, positions_by_joint
from tests.six_axis_arm import HEAD, YAML, joints, write_six_axis
from tests.small_robots import ARM_YAML, small_arm, write_arm


def some_poses(n):
    return np.random.default_rng(1).uniform([-1, 0, -1], [1, 0.5, 1], (n, 3))


def test_without_noise_the_positions_are_those_of_the_robot(tmp_path):
    arm = small_arm(tmp_path)
    truth, q, names = arm.with_parameters({"slide.x": 0.26}), some_poses(10), tuple("abcdefghij")
    data = calib.simulate(truth, calib.Poses(q, names, names, "here", ()), 0.0, np.random.default_rng(1))
    assert np.array_equal(data.points(arm), truth.positions(q))
    assert np.array_equal(data.joints, q)
    assert data.names == names
    assert data.n_readings == 10


def test_noise_is_normal_and_the_same_on_every_axis(tmp_path):
    arm, q = small_arm(tmp_path), some_poses(4000)
    noise = calib.simulate(arm, q, 2e-4, np.random.default_rng(2)).points(arm) - arm.positions(q)
    z = noise[:, 0] / 2e-4
    # four standard deviations: 4 / sqrt(4000) of means and correlations, 4 sqrt(2 / 4000) of variances
    assert np.abs(z.mean(axis=0)).max() < 0.064
    assert np.abs(z.var(axis=0) - 1).max() < 0.09
    assert np.abs(np.corrcoef(z.T) - np.eye(3)).max() < 0.064
    assert np.mean(np.abs(z) > 1.959964) == pytest.approx(0.05, abs=0.008)


@pytest.mark.parametrize("sigma", [-1e-4, np.nan, np.inf])
def test_a_sigma_that_cannot_be_is_an_error(tmp_path, sigma):
    with pytest.raises(DataError, match="must be zero or a positive number"):
        calib.simulate(small_arm(tmp_path), some_poses(3), sigma, np.random.default_rng(1))


def test_the_command_writes_the_truth_the_noise_and_the_seed_into_the_file(tmp_path, run_calib):
    arm = small_arm(tmp_path)
    (tmp_path / "q.csv").write_text("pose,turn,slide,wrist\nfirst,0.1,0.2,0.3\nfirst,0.1,0.2,0.3\nsecond,0.3,0.2,0.1\n")
    (tmp_path / "truth.csv").write_text("parameter,value,unit\nslide.x,260,mm\n")
    command = "simulate arm.yaml q.csv --parameters truth.csv --sigma-mm 0.05 --seed 7 --out m.csv"
    run = run_calib(*command.split(), cwd=tmp_path)
    unchecked = "note: collisions are not checked: the robot file has no collision shapes, and the description names no"
    assert (run.code, run.out) == (0, "3 simulated poses written to m.csv, seed 7\n")
    assert run.err == f"{unchecked} obstacles\n"
    table = read_table(tmp_path / "m.csv")
    assert table.comments == (
        "simulated measurements of small arm; truth: truth.csv",
        "normal noise, sigma 0.05 mm per axis, seed 7",
    )
    data = calib.read_measurements(tmp_path / "m.csv", arm)
    assert data.pose_numbers.tolist() == [0, 0, 1]  # repeats of a pose are measured each
    exact = arm.with_parameters({"slide.x": 0.26}).positions(data.joints)
    assert 0 < np.abs(data.points(arm) - exact).max() < 3e-4
    assert np.abs(np.diff(data.points(arm)[:2], axis=0)).min() > 0
    first = (tmp_path / "m.csv").read_bytes()
    for seed in ("7", "8"):
        run_calib(*command.replace("seed 7", f"seed {seed}").split(), cwd=tmp_path)
        assert ((tmp_path / "m.csv").read_bytes() == first) == (seed == "7")


STATED = (
    ARM_YAML
    + """\
instruments:
  tracker: {kind: position, target: tip, sigma: {range: 0.5 mm, angle: 0.2 mrad}}
  scale: {kind: position, target: tip, sigma: [0.1 mm, 0.2 mm, 0.3 mm]}
  unstated: {kind: position, target: tip}
"""
)


def test_without_a_sigma_every_instrument_has_the_noise_that_is_stated_of_it(tmp_path):
    robot = calib.load(write_arm(tmp_path, STATED))
    q = some_poses(4000)
    data = calib.simulate(robot, q, None, np.random.default_rng(2))
    exact = robot.positions(q)[:, 0]
    off = {name: readings.values - exact for name, readings in data.readings.items()}
    # four standard errors of a standard deviation: 4 / sqrt(2 * 4000) = 4.5 %
    assert np.std(off["scale"], axis=0) == pytest.approx([1e-4, 2e-4, 3e-4], rel=0.045)
    assert not off["unstated"].any()  # unstated noise is none
    distance = np.linalg.norm(exact, axis=1)
    beam = exact / distance[:, None]
    along = np.sum(off["tracker"] * beam, axis=1)
    across = off["tracker"] - along[:, None] * beam
    assert np.std(along) == pytest.approx(5e-4, rel=0.045)
    # two components across, each angle times distance
    assert np.sqrt(np.mean(np.sum(across**2, axis=1) / 2 / distance**2)) == pytest.approx(2e-4, rel=0.045)


def test_joints_that_do_not_come_back_move_all_that_is_read_of_a_visit_alike(tmp_path):
    robot, q = calib.load(write_arm(tmp_path, STATED)), some_poses(2000)
    data = calib.simulate(robot, q, 0.0, np.random.default_rng(2), joint_sigma=1e-4)
    assert np.array_equal(data.joints, q)
    np.testing.assert_array_equal(data.readings["tracker"].values, data.readings["scale"].values)
    off = data.readings["tracker"].values - robot.positions(q)[:, 0]
    slopes = positions_by_joint(robot, q)[:, 0] * robot.mechanism.joint_scale
    expected = 1e-4 * np.sqrt(np.mean(np.sum(slopes**2, axis=2), axis=0))
    assert np.sqrt(np.mean(off**2, axis=0)) == pytest.approx(expected, rel=0.07)


WIRE = "  wire: {kind: distance, target: tip, end: {frame: world}}\n"


@pytest.mark.parametrize(
    ("more", "options", "words"),
    [
        ("", (), "states no noise (sigma) of 'unstated'; state it there, or give --sigma-mm"),
        (WIRE, (), "of 'unstated', 'wire'; state it there (--sigma-mm is for positions only)"),
        (WIRE, ("--sigma-mm", "0.1"), "of 'wire'; state it there (--sigma-mm is for positions only)"),
        ("", ("--sigma-mm", "-1"), "--sigma-mm -1: must be zero or a positive number"),
    ],
)
def test_noise_that_nobody_states_is_asked_for_before_anything_is_written(tmp_path, run_calib, more, options, words):
    write_arm(tmp_path, STATED + more.replace("world", small_arm(tmp_path).description.base.frame))
    (tmp_path / "q.csv").write_text("turn,slide,wrist\n0.1,0.2,0.3\n")
    command = ("simulate", "arm.yaml", "q.csv", "--seed", "1", "--out", "m.csv")
    assert words in run_calib(*command, *options, cwd=tmp_path).refusal()
    assert not (tmp_path / "m.csv").exists()
    assert run_calib(*command, "--sigma-mm", "0", cwd=tmp_path).code == 0


KINDS = {
    "positions": "  t: {kind: position, target: ball, sigma: {range: 0.01 mm, angle: 5 urad}}\n",
    "poses": "  t: {kind: pose, target: ball, rotation: rpy, sigma: 0.01 mm, sigma_angle: 0.02 mrad}\n",
    "turns": "  t: {kind: position, target: ball, sigma: 0.01 mm}\n"
    "  o: {kind: orientation, target: ball, sigma: 0.01 deg}\n"
    "  tilt: {kind: orientation, axes: gravity, target: ball, sigma: 0.01 deg}\n"
    "  e: {kind: joint_reading, joint: j4, zero: unknown, sigma: 0.001 deg}\n",
    "distances": "".join(
        f"  d{k}: {{kind: distance, target: ball, end: {{frame: l0, xyz: {xyz}, position: unknown}}, offset: unknown,"
        " sigma: 0.01 mm}\n"
        for k, xyz in enumerate(("[1, 0, 0]", "[0, 1, 0]", "[1, 1, 1]"))
    ),
    "pixels": "".join(
        f"  {name}: {{kind: pixel, target: ball, camera: {{frame: l0, xyz: {xyz}, rpy: {rpy}}}, columns: pixel, sigma:"
        f" 0.1, intrinsics: {INTRINSICS}, points: {POINTS}}}\n"
        for name, xyz, rpy in (("left", "[0.5, 0, 4]", "[3.14, 0, 0]"), ("right", "[4.5, 0, 0.7]", "[-1.57, 0, 1.57]"))
    ),
    "planes": "  probe: {kind: touch, surface: plane, radius: 3 mm, target: ball, sigma: 0.01 mm, places: {"
    "a: {frame: l0, xyz: [0.6, 0.1, 0.3], position: unknown, orientation: unknown},"
    " b: {frame: l0, xyz: [0.4, -0.1, 0.6], rpy: [0.1, 1.1, 0.2], position: unknown, orientation: unknown}}}\n",
    "sockets": "  probe: {kind: touch, target: ball, sigma: 0.01 mm, artefact: {frame: l0, xyz: [0.5, 0.2, 0.6],"
    " rpy: [0.3, -0.4, 2], pose: unknown, points: {a: [0, 0, 0], b: [90 mm, 0, 0], c: [0, 200 mm, 100 mm]}}}\n",
    "loose sockets": "  probe: {kind: touch, target: ball, sigma: 0.01 mm, artefact: {frame: l0, xyz: [0.5, 0.2, 0.6],"
    " rpy: [0.3, -0.4, 2], pose: unknown, tolerance: 0.1 mm,"
    " points: {a: [0, 0, 0], b: [90 mm, 0, 0], c: [0, 200 mm, 100 mm]}}}\n",
    "spheres": "  probe: {kind: touch, surface: sphere, radius: 3 mm, target: ball, sigma: 0.01 mm, places: {"
    "a: {frame: l0, xyz: [0.5, 0.2, 0.6], position: unknown, radius: 40 mm},"
    " b: {frame: l0, xyz: [0.4, -0.3, 0.4], position: unknown, radius: unknown}}}\n",
    "spheres of one piece": "  probe: {kind: touch, surface: sphere, target: ball, sigma: 0.01 mm, artefact: {"
    "frame: l0, xyz: [0.5, 0.2, 0.6], pose: unknown, radius: 30 mm,"
    " points: {a: [0, 0, 0], b: [0, 0.2, 0], c: [0.1, 0, 0.2]}}}\n",
}
SETUPS = {
    "positions": "setups: {first: [], tracker moved: [base], remounted: [ball]}\n",
    "sockets": "setups: {first: [], turned: [probe_artefact]}\n",
}
LATER = {
    "positions": {"base.x": 1500.0, "base@tracker moved.x": -1100.0, "ball@remounted.z": 90.0},
    "sockets": {"probe_artefact@turned.z": 40.0},
    "loose sockets": {"probe.b.x": 0.15, "probe.c.y": -0.1},
    "spheres": {"a.x": 510.0, "b.radius": 25.0},
    "spheres of one piece": {"probe_artefact.x": 520.0},
}
"""True values beside `TRUTH` [mm]."""


@pytest.mark.quick(1)
@pytest.mark.parametrize("kind", list(KINDS))
def test_every_kind_goes_through_a_file_and_the_truth_is_found_again(tmp_path, run_calib, kind):
    """With setups where there are any; touches start from joint values that do not touch."""
    pose = ", pose: unknown" if kind == "positions" else ""
    turned = ", orientation: unknown" if kind in ("poses", "turns", "pixels") else ""
    target = f"{{frame: l6, xyz: [50 mm, 20 mm, 100 mm], position: unknown{turned}}}"
    yaml = (
        f"{HEAD}priors: false\nbase: {{frame: l0{pose}}}\n"
        f"targets: {{ball: {target}}}\ninstruments:\n{KINDS[kind]}{SETUPS.get(kind, '')}parametrisation:\n{FREE}"
    )
    robot = calib.load(write_six_axis(tmp_path, yaml))
    millimetres = LATER.get(kind, {}) | {"j3.z": 602.0, "j5.x": 397.0}
    lines = ["parameter,value,unit", *(f"{name},{value},mm" for name, value in millimetres.items()), "j4.rx,10,mrad"]
    (tmp_path / "truth.csv").write_text("\n".join(lines) + "\n")
    (tmp_path / "q.csv").write_text(plan_of(robot, 60))
    options = ("--parameters", tmp_path / "truth.csv", "--seed", 2, "--out", tmp_path / "m.csv")
    run = run_calib("simulate", robot.path, tmp_path / "q.csv", *options)
    assert run.code == 0, run.err
    assert "noise as the description states it, seed 2" in read_table(tmp_path / "m.csv").comments[1]
    fit = calib.fit(robot, calib.read_measurements(tmp_path / "m.csv", robot))
    truth = {name: value * 1e-3 for name, value in millimetres.items()} | {"j4.rx": 0.01, "j2.ry": 0.0}
    by_name = dict(zip(fit.free_names, fit.robot.values[fit.unknowns.index], strict=True))
    width = dict(zip(fit.free_names, fit.statistics.half_width, strict=True))
    for name, value in truth.items():
        assert abs(by_name[name] - value) < 2 * width[name], name
    for noise in fit.noise:
        assert noise.sigma == pytest.approx(noise.stated, rel=0.35)


def centres(robot, item):
    """Centres of what an instrument touches, (n, 3) [m]."""
    if not item.points_of_artefact:
        return np.array([robot.mechanism.placement(name).translation for name in item.named])
    place = robot.mechanism.placement("probe_artefact")
    return np.array([place.act(np.array(point)) for point in item.points_of_artefact])


def plan_of(robot, n):
    """Joint values, in which setup, and what is touched, in turn; starts near sockets and spheres, or anywhere."""
    q, touches = joints(n, 1), [instrument for instrument in robot.instruments if not instrument.columns()]
    if any(touch.surface != "plane" for touch in touches):
        points = centres(robot, touches[0])[np.arange(2 * n) % len(touches[0].named)]
        if touches[0].surface == "sphere":  # the ball outside, at random directions of the upper half
            away = np.random.default_rng(4).normal(size=points.shape)
            points = points + 0.04 * np.abs(away) / np.linalg.norm(away, axis=1, keepdims=True)
        q, ok = brought(robot, joints(2 * n, 1), points)
        q = q[ok & np.all(np.abs(q) < 2.5, axis=1)][:n] + np.random.default_rng(3).normal(0, 0.05, (n, 6))
    setups = list(robot.description.setups)
    header = [f"{name} [rad]" for name in robot.joint_names] + [touch.name for touch in touches]
    rows = [",".join(header + (["setup"] if setups else []))]
    for k, row in enumerate(q):
        cells = [*map(repr, row.tolist()), *(touch.named[k % len(touch.named)] for touch in touches)]
        rows.append(",".join(cells + ([setups[k * len(setups) // n]] if setups else [])))
    return "\n".join(rows) + "\n"


def test_a_stated_direction_of_approach_counts_in_plans_and_predictions(tmp_path, run_calib):
    yaml = ARM_YAML + "  - {joint: slide, term: backlash, sigma: 0.1 mm}\n"
    robot = calib.load(write_arm(tmp_path, yaml))
    rows = "0.1,0.2,0.3,-1\n0.1,0.3,0.3,-1\n0.1,0.4,0.3,1\n"
    (tmp_path / "plan.csv").write_text(f"turn,slide,wrist,approach_slide\n{rows}")
    (tmp_path / "values.csv").write_text("parameter,value,unit\nslide.backlash,0.5,mm\n")
    given = ("arm.yaml", "plan.csv", "--parameters", "values.csv")
    assert run_calib("predict", *given, "--out", "predicted.csv", cwd=tmp_path).code == 0
    options = ("--sigma-mm", "0", "--seed", "1", "--out", "simulated.csv")
    assert run_calib("simulate", *given, *options, cwd=tmp_path).code == 0
    actual = np.array([[0.1, 0.2 - 5e-4, 0.3], [0.1, 0.3 - 5e-4, 0.3], [0.1, 0.4 + 5e-4, 0.3]])
    for name in ("predicted.csv", "simulated.csv"):
        points = calib.read_measurements(tmp_path / name, robot).points(robot)
        np.testing.assert_allclose(points, robot.positions(actual), atol=1e-12)
    data = calib.read_measurements(tmp_path / "simulated.csv", robot)
    assert data.states_approach
    assert data.approach[:, 1].tolist() == [-1, -1, 1]


@pytest.mark.quick(1)
@pytest.mark.parametrize("kind", ["planes", "sockets", "spheres"])
def test_touches_are_the_same_whatever_rounding_does(tmp_path, kind):
    """The joints move along nothing that the gaps do not feel, however little damping is left."""
    yaml = f"instruments:\n{KINDS[kind]}{YAML}{FREE}"
    robot = calib.load(write_six_axis(tmp_path, yaml))
    (tmp_path / "q.csv").write_text(plan_of(robot, 60))
    plan, rng = read_plan(tmp_path / "q.csv", robot), np.random.default_rng(0)
    first = calib.simulate(robot, plan, seed=2).joints
    for _ in range(3):
        rounded = replace(plan, joints=plan.joints * (1.0 + 1e-15 * rng.standard_normal(plan.joints.shape)))
        np.testing.assert_allclose(calib.simulate(robot, rounded, seed=2).joints, first, rtol=0.0, atol=1e-9)
