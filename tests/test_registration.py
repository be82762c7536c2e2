"""Placing an unknown measurement frame and unknown targets: exact from exact measurements, whatever is unknown."""

import numpy as np
import pytest
from small_robots import ARM_YAML, write_arm

import calib
from calib.errors import DataError
from calib.linearisation.registration import register

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


def exact(robot, n=12):
    generator = np.random.default_rng(41)
    q = generator.uniform([-1.5, 0, -1.5], [1.5, 0.5, 1.5], (n, 3))
    names = tuple(str(k) for k in range(n))
    return calib.simulate(robot, calib.Poses(q, names, names, "exact", ()), 0.0, generator)


BASE = {"base.x": 3.0, "base.y": -2.0, "base.z": 1.0, "base.rx": 2.0, "base.ry": -1.0, "base.rz": 0.5}


@pytest.mark.parametrize(
    ("base", "targets", "truth"),
    [
        ("unknown", [("tip", "tool", "known")], BASE),
        ("known", [("tip", "tool", "unknown")], {"tip.x": 0.2, "tip.y": -0.1, "tip.z": 0.05}),
        ("unknown", [("tip", "tool", "unknown")], BASE | {"tip.x": 0.2, "tip.y": -0.1, "tip.z": 0.05}),
        (
            "unknown",
            [("elbow", "slider", "unknown"), ("tip", "tool", "unknown")],
            BASE | {"tip.x": 0.2, "tip.y": -0.1, "elbow.x": -0.05, "elbow.y": 0.3, "elbow.z": 0.02},
        ),
        ("known", [("elbow", "slider", "known"), ("tip", "tool", "unknown")], {"tip.z": -0.4}),
    ],
)
def test_what_is_unknown_is_found_exactly(tmp_path, base, targets, truth):
    robot = robot_with(tmp_path, base=base, targets=targets)
    data = exact(robot.with_parameters(truth))
    placed = register(robot, data)
    assert np.abs(placed.positions(data.joints) - data.positions).max() < ROUNDING
    places = [p.placement for p in robot.parameters]
    assert np.array_equal(placed.values[np.logical_not(places)], robot.values[np.logical_not(places)])


def test_with_everything_known_nothing_changes(tmp_path):
    robot = robot_with(tmp_path, base="known", targets=[("tip", "tool", "known")])
    assert np.array_equal(register(robot, exact(robot)).values, robot.values)


def test_points_that_fix_no_frame_are_an_error(tmp_path):
    robot = robot_with(tmp_path, base="unknown", targets=[("tip", "tool", "known")])
    q = np.array([[0.1, s, 0.2] for s in (0.0, 0.1, 0.2, 0.3)])  # along a line
    names = ("a", "b", "c", "d")
    data = calib.simulate(robot, calib.Poses(q, names, names, "line", ()), 0.0, np.random.default_rng(1))
    with pytest.raises(DataError):
        register(robot, data)
