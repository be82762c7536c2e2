"""Placing an unknown measurement frame and unknown targets: exact from exact measurements, whatever is unknown."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib
from calib.core.base.errors import DataError
from calib.core.rows.registration import register
from medrue import robot_file
from tests.project import EXAMPLES, copied
from tests.small_robots import ARM_YAML, write_arm
from tests.urdf_trees import urdf_of

ROUNDING = 1e-9
"""The iteration of the rigid fits stops below a nanometre."""


def robot_with(tmp_path, *, base, targets):
    """The arm with an unknown or known base, and targets with their known or unknown positions."""
    lines = [
        f"  {name}: {{frame: {frame}, xyz: [0.01, 0.02, 0.03], position: {state}}}" for name, frame, state in targets
    ]
    yaml = ARM_YAML[: ARM_YAML.index("base:")]
    yaml += f"base: {{frame: ground, pose: {base}, xyz: [0.1, 0, 0], rpy: [0, 0, 0.1]}}\ntargets:\n" + "\n".join(lines)
    return calib.load(write_arm(tmp_path, yaml + "\n" + ARM_YAML[ARM_YAML.index("parametrisation:") :]))


def exact(robot):
    generator = np.random.default_rng(41)
    return calib.simulate(robot, generator.uniform([-1.5, 0, -1.5], [1.5, 0.5, 1.5], (12, 3)), 0.0, generator)


BASE = {"base.x": 3.0, "base.y": -2.0, "base.z": 1.0, "base.rx": 2.0, "base.ry": -1.0, "base.rz": 0.5}


@pytest.mark.parametrize(
    ("base", "targets", "truth"),
    [
        ("unknown", [("tip", "tool", "known")], BASE),
        ("known", [("tip", "tool", "unknown")], {"tip.x": 0.2, "tip.y": -0.1, "tip.z": 0.05}),
        (
            "unknown",
            [("elbow", "slider", "unknown"), ("tip", "tool", "unknown")],
            BASE | {"tip.x": 0.2, "tip.y": -0.1, "elbow.x": -0.05, "elbow.y": 0.3, "elbow.z": 0.02},
        ),
        ("known", [("elbow", "slider", "known"), ("tip", "tool", "unknown")], {"tip.z": -0.4}),
        ("known", [("tip", "tool", "known")], {}),
    ],
)
def test_what_is_unknown_is_found_exactly_from_wherever_it_was_and_the_rest_stays(tmp_path, base, targets, truth):
    robot = robot_with(tmp_path, base=base, targets=targets).with_parameters({"turn.x": 0.01, "wrist.rz": 0.02})
    true = robot.with_parameters(truth)
    data = exact(true)
    elsewhere = {"base.x": -7.0, "base.rz": -2.0, "tip.y": 0.4}
    for start in (robot, true, true.with_parameters({name: elsewhere[name] for name in elsewhere if name in truth})):
        placed = register(start, data)
        assert np.abs(placed.positions(data.joints) - data.points(robot)).max() < ROUNDING
        assert np.abs(placed.values - true.values).max() < 1e-8
        places = [p.placement for p in robot.parameters]
        assert np.array_equal(placed.values[np.logical_not(places)], robot.values[np.logical_not(places)])


def test_held_places_stay(tmp_path):
    robot = robot_with(tmp_path, base="known", targets=[("tip", "tool", "unknown")])
    description = robot.description.model_copy(update={"held": ("tip.y",)})
    robot = replace(robot, description=description).with_parameters({"tip.x": 0.2})
    truth = robot.with_parameters({"tip.x": -0.1, "tip.z": 0.3})
    assert register(robot, exact(truth)).values == pytest.approx(truth.values)


def test_points_that_fix_no_frame_leave_it_open_and_the_fit_says_so(tmp_path):
    robot = robot_with(tmp_path, base="unknown", targets=[("tip", "tool", "known")])
    q = np.array([[0.1, s, 0.2] for s in np.linspace(0, 0.5, 9)])  # along a line
    data = calib.simulate(robot, q, 0.0, np.random.default_rng(1))
    placed = register(robot, data)
    assert np.abs(placed.values - robot.values).max() < 1e-9
    with pytest.raises(DataError, match=r"lie on one line.*hold what stays open"):
        calib.fit(robot, data)


R, P = "revolute", "prismatic"
CHAINS = {
    "pan-tilt": [(R, "0 0 0.2", "0 0 1"), (R, "0 0 0.1", "0 1 0")],
    "three axes that meet": [(R, "0 0 0.2", "0 0 1"), (R, "0 0 0", "0 1 0"), (R, "0 0 0", "1 0 0")],
    "SCARA": [(R, "0 0 0.2", "0 0 1"), (R, "0.3 0 0", "0 0 1"), (P, "0.25 0 0", "0 0 -1"), (R, "0 0 0", "0 0 -1")],
    "linear axis": [(P, "0 0 0.2", "1 0 0")],
    "turntable": [(R, "0 0 0.2", "0 0 1")],
    "gantry": [(P, "0 0 0.2", "1 0 0"), (P, "0 0 0.2", "0 1 0"), (P, "0 0 0.2", "0 0 1")],
}
FREE_PLACES = "pose: unknown}\ntargets: {tip: {frame: LAST, xyz: [0, 0, 0.1], position: unknown}}\nparametrisation:\n"


def chain(folder, name, held=""):
    """A robot of joints one after the other, with unknown base and target."""
    axes = CHAINS[name]
    joints = (
        (f"j{k}", kind, f"l{k}", f"l{k + 1}", f'<origin xyz="{xyz}"/><axis xyz="{axis}"/>')
        for k, (kind, xyz, axis) in enumerate(axes)
    )
    (folder / "chain.urdf").write_text(urdf_of(*joints))
    text = f"urdf: chain.urdf\nname_mot: [{', '.join(f'j{k}' for k in range(len(axes)))}]\nbase: {{frame: l0, "
    text += FREE_PLACES.replace("LAST", f"l{len(axes)}") + "  - {origin: j0, components: [x], sigma: 1 mm}\n"
    (folder / "chain.yaml").write_text(text + f"held: [{held}]\n")
    return calib.load(folder / "chain.yaml")


def arm(folder):
    return robot_with(folder, base="unknown", targets=[("tip", "tool", "unknown")])


def five_bar(folder):
    return calib.load(copied(folder, EXAMPLES / "five_bar.yaml", ("20 mm]}", "20 mm], position: unknown}")))


def medrue_unplaced(folder):
    text = robot_file().read_text()
    text = text[: text.index("base:")].replace("medrue.urdf", str(robot_file().with_name("medrue.urdf")))
    (folder / "medrue.yaml").write_text(
        text + "base: {frame: world, " + FREE_PLACES.replace("LAST", "tool") + "  - {origin: q1, components: [x],"
        " sigma: 1 mm}\n"
    )
    return calib.load(folder / "medrue.yaml")


@pytest.mark.quick(1)
@pytest.mark.parametrize("make", [*CHAINS, arm, five_bar, medrue_unplaced])
def test_a_tracker_anywhere_and_a_reflector_anywhere_are_found_without_help(make, tmp_path):
    robot = chain(tmp_path, make) if isinstance(make, str) else make(tmp_path)
    generator = np.random.default_rng(5)
    q = robot.home + (0.05 if robot.passive_names else 1) * generator.uniform(-1, 1, (12, len(robot.home)))
    target = robot.target_names[0]
    for _ in range(10):
        place = 10 * generator.standard_normal(3), Rotation.random(random_state=generator).as_rotvec()
        values = dict(zip(BASE, np.concatenate(place), strict=True))
        values |= dict(zip([f"{target}.{axis}" for axis in "xyz"], generator.uniform(-0.3, 0.3, 3), strict=True))
        measured = robot.with_parameters(values).positions(q)
        placed = register(robot, calib.as_measurements(robot, q, measured))
        assert np.abs(placed.positions(q) - measured).max() < ROUNDING
        measured += generator.normal(0, 1e-4, measured.shape)
        placed = register(robot, calib.as_measurements(robot, q, measured))
        # least squares leave no more than the noise: chi-square of 36 numbers is below 80 in all but 3 of 100000
        assert np.sum((placed.positions(q) - measured) ** 2) < 80 * 1e-4**2


def test_axes_that_meet_are_calibrated(tmp_path):
    robot = chain(tmp_path, "pan-tilt", held="j0.x")
    truth = robot.with_parameters(BASE | {"tip.x": 0.01, "tip.y": 0.02, "tip.z": 0.13})
    q = np.random.default_rng(6).uniform(-1, 1, (20, 2))
    measured = truth.positions(q) + np.random.default_rng(7).normal(0, 1e-4, (20, 1, 3))
    fit = calib.fit(robot, calib.as_measurements(robot, q, measured))
    assert np.abs(fit.robot.values - truth.values).max() < 1e-3  # five times the noise over arms of 0.13 m


def test_a_linear_axis_is_calibrated_where_the_turn_about_it_is_held(tmp_path):
    robot = chain(tmp_path, "linear axis", held="j0.x, tip.x, tip.y, tip.z, base.rx")
    truth = robot.with_parameters({"base.x": 3.0, "base.y": -2.0, "base.ry": 0.2, "base.rz": 0.9})
    q = np.linspace(-1, 1, 10)[:, None]
    measured = truth.positions(q) + 1e-4 * np.sin(np.arange(30)).reshape(10, 1, 3)
    fit = calib.fit(robot, calib.as_measurements(robot, q, measured))
    assert np.abs(fit.robot.values - truth.values).max() < 1e-3


@pytest.mark.quick(0)
def test_a_turntable_says_what_its_one_axis_leaves_open(tmp_path):
    robot = chain(tmp_path, "turntable", held="j0.x")
    q = np.linspace(-1, 1, 10)[:, None]
    data = calib.as_measurements(robot, q, robot.with_parameters(BASE | {"tip.x": 0.2}).positions(q))
    said = r"7 combinations of the 9 free parameters can be found .*; .*; not separable: base.x,.*tip.z"
    with pytest.raises(calib.NotIdentifiableError, match=said):
        calib.fit(robot, data)


def test_before_keeps_a_target_near_where_it_is_expected(tmp_path):
    """Where joints hardly turn, the robot's own errors would carry its reflector away, whatever noise is stated."""
    near = robot_with(tmp_path, base="unknown", targets=[("tip", "tool", "unknown, sigma: 5 mm")])
    q = np.random.default_rng(8).uniform([-0.02, 0, -0.02], [0.02, 0.5, 0.02], (40, 3))
    measured = near.positions(q) + np.random.default_rng(9).normal(0, 2e-3, (40, 1, 3))
    data = calib.as_measurements(near, q, measured)
    far = robot_with(tmp_path, base="unknown", targets=[("tip", "tool", "unknown")])
    moved = {}
    for name, robot in (("near", near), ("far", far)):
        fit = calib.fit(robot, data, sigma=5e-5)
        where = [p.name in ("tip.x", "tip.y", "tip.z") for p in robot.parameters]
        moved[name] = np.abs(fit.placed.values - robot.values)[where].max()
        errors = fit.placed.positions(q) - measured
        assert np.allclose(errors[:, 0], fit.identification.before["tip"], rtol=0, atol=1e-12)
    assert moved["near"] < 0.010 < 0.020 < moved["far"]


def test_positions_and_poses_may_be_read_at_different_visits(tmp_path):
    text = (
        "  reflector: {frame: flange, xyz: [20 mm, 0 mm, 50 mm], position: unknown, sigma: 5 mm}\n"
        "  sensor: {frame: flange, position: unknown, orientation: unknown, sigma: 5 mm, sigma_angle: 20 mrad}\n"
        "instruments:\n"
        "  tracker: {kind: position, target: reflector, sigma: 0.03 mm}\n"
        "  camera: {kind: pose, target: sensor, sigma: 0.2 mm, sigma_angle: 1 mrad}\n"
    )
    lines = (EXAMPLES / "arm.yaml").read_text().splitlines(keepends=True)
    target = next(line for line in lines if line.startswith("  reflector:"))
    robot = calib.load(copied(tmp_path, EXAMPLES / "arm.yaml", (target, text)))
    both = calib.simulate(robot, robot.sample(60, seed=1), None, 2)
    apart = both.with_readings({"tracker": np.arange(40), "camera": np.arange(40, 60)})
    fit = calib.fit(robot, apart)
    assert fit.converged
    assert fit.verdict.grade == "PASS"


def test_readings_that_hardly_show_a_place_leave_it_where_points_put_it(tmp_path):
    """Heights alone determine no place in the plane; their instrument comes first, by its name."""
    instruments = "instruments:\n  a: {kind: height, target: reflector}\n  b: {kind: position, target: reflector}\n"
    robot = calib.load(copied(tmp_path, EXAMPLES / "arm.yaml", ("sigma: 0.03 mm", instruments)))
    true = robot.with_parameters({"base.x": 3.0, "base.rz": 1.0, "reflector.y": 0.004})
    q = calib.sample(robot, 20, seed=5).joints
    points = true.positions(q)[:, 0]
    placed = register(robot, calib.as_measurements(robot, q, {"a": points[:, 2:], "b": points}))
    assert placed.positions(q)[:, 0] == pytest.approx(points, abs=ROUNDING)
