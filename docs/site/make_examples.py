"""Write the files of docs/examples that are made: simulated measurements of every robot, and the robots of templates.

    python docs/site/make_examples.py [FOLDER]

Each robot gets true parameters drawn at random, is sent to random poses, and is measured with normal noise. The truth
is shipped too, so that a reader can see how near a calibration comes to it. Four-bar, 3-RRR, delta and hexapod are what
`calib init --template` writes.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

import calib
from calib.core.base.units import DISPLAY_UNIT, PER_SI
from calib.core.data.measurements import Poses
from calib.core.data.table_writing import format_table
from calib.starting.dh_tables import urdf_of_table
from calib.starting.templates import TEMPLATES as MECHANISMS

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
Array = NDArray[np.float64]

# Where the tracker sees the robot's base from, and the noise of one reading.
ARM_BASE = {"base.x": 2.1, "base.y": -1.4, "base.z": 0.6, "base.rx": 0.01, "base.ry": -0.02, "base.rz": 2.2}
ARM_SIGMA, ARM_SEED, ARM_POSES = 0.03e-3, 8, 80
TOUCH_SIGMA, TOUCH_SEED, TOUCHES = 0.02e-3, 6, 75
PLATE = (0.5, 0.1, 0.35)  # where the first socket is [m]
SOCKETS = """
urdf: arm.urdf
name_mot: [joint_1, joint_2, joint_3, joint_4, joint_5, joint_6]
base: {frame: base_link}
targets: {ball: {frame: flange, position: unknown, sigma: 20 mm}}
instruments: {probe: {kind: touch, target: ball, places: {a: {frame: base_link, position: unknown}}}}
parametrisation:
  - {origin: all, components: [x, y, z], sigma: 1 mm}
  - {origin: all, components: [rx, ry, rz], sigma: 3 mrad}
"""
UR_BASE = {"base.x": 1.9, "base.y": 0.8, "base.z": 0.4, "base.rx": 0.004, "base.ry": -0.006, "base.rz": -2.4}
UR_SIGMA, UR_SEED, UR_POSES = 0.022e-3, 11, 60
UR = """
urdf: ur10e.urdf
name_mot: [shoulder_pan_joint, shoulder_lift_joint, elbow_joint, wrist_1_joint, wrist_2_joint, wrist_3_joint]
base: {frame: base_link, pose: unknown}
targets: {reflector: {frame: flange, xyz: [30 mm, 0 mm, 20 mm], position: unknown}}
parametrisation:
  - {origin: all, components: [x, y, z], sigma: 1 mm}
  - {origin: all, components: [rx, ry, rz], sigma: 3 mrad}
"""
FIVE_BAR_BASE = {"base.x": 0.4, "base.y": 1.1, "base.z": -0.3, "base.rx": 0.02, "base.ry": 0.03, "base.rz": -1.2}
TEMPLATES = {"four_bar": 40, "3rrr": 60, "delta": 60, "stewart": 80}  # and how many poses
TEMPLATE_SIGMA, TEMPLATE_SEED = 0.02e-3, 3
FIVE_BAR_SIGMA, FIVE_BAR_SEED, FIVE_BAR_POSES = 0.02e-3, 5, 40


def arm() -> dict[str, str]:
    """Return the files of the serial arm."""
    robot = calib.load(EXAMPLES / "arm.yaml")
    rng = np.random.default_rng(ARM_SEED)
    low, high = np.array([[-80, -40, -10, -120, -90, -170], [80, 80, 100, 120, 90, 170]], dtype=float)
    poses: list[Array] = []
    while len(poses) < ARM_POSES:
        degrees = np.round(rng.uniform(low, high), 3)
        x, _, z = robot.positions(np.radians(degrees))[0, 0]
        if x > 0.1 and z > 0.15:  # in front of the robot, where the tracker sees it, and above the table
            poses.append(np.radians(degrees))
    truth = _drawn(robot, rng) | ARM_BASE
    for axis, offset in zip("xyz", (1.5e-3, -2.0e-3, 0.8e-3), strict=True):
        truth[f"reflector.{axis}"] += offset
    return _files(robot, "arm", np.array(poses), truth, ARM_SIGMA, ARM_SEED, rng)


def ur10e() -> dict[str, str]:
    """Return the files of the UR10e, whose nominal robot is a Denavit-Hartenberg table."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "ur10e.yaml"
        path.write_text(UR)
        path.with_suffix(".urdf").write_text(urdf_of_table(EXAMPLES / "ur10e_dh.csv"))
        robot = calib.load(path)
    rng = np.random.default_rng(UR_SEED)
    low, high = np.degrees(robot.joint_limits).T
    poses: list[Array] = []
    while len(poses) < UR_POSES:
        degrees = np.round(rng.uniform(low, high), 3)
        x, y, z = robot.positions(np.radians(degrees))[0, 0]
        if z > 0.1 and np.hypot(x, y) > 0.3:  # above the table, and away from the robot's own base
            poses.append(np.radians(degrees))
    truth = _drawn(robot, rng) | UR_BASE
    for axis, offset in zip("xyz", (0.9e-3, -1.4e-3, 0.5e-3), strict=True):
        truth[f"reflector.{axis}"] += offset
    return _files(robot, "ur10e", np.array(poses), truth, UR_SIGMA, UR_SEED, rng, nominal="ur10e_dh.csv")


def touches() -> dict[str, str]:
    """Return the touches of the serial arm: joint values at which the ball on its flange sits in the sockets."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "sockets.yaml"
        path.write_text(SOCKETS.replace("arm.urdf", str(EXAMPLES / "arm.urdf")))
        robot = calib.load(path)
        rng = np.random.default_rng(TOUCH_SEED)
        truth = {name: value for name, value in _drawn(robot, rng).items() if not name.startswith("probe")}
        truth |= {"ball.x": 0.002, "ball.y": -0.003, "ball.z": 0.012}
        actual = robot.with_parameters(truth)
        low, high = np.radians([[-80, -60, -30, -170, -110, -175], [120, 100, 130, 170, 110, 175]])
        starts = rng.uniform(low, high, (8 * TOUCHES, 6))
        points = np.array([(0.0, 0.0, 0.0), (0.2, 0.0, 0.0), (0.0, 0.15, 0.0)])[np.arange(len(starts)) % 3]
        seats = np.array(PLATE) + points + rng.normal(0.0, TOUCH_SIGMA, points.shape)
        q = _brought(actual, starts, seats)
        gap = np.linalg.norm(actual.positions(q)[:, 0] - seats, axis=1)
        reached = np.flatnonzero((gap < 1e-7) & np.all((q > low) & (q < high), axis=1))[:TOUCHES]
        names = "abc"
        columns: list[tuple[str, object]] = [
            ("pose", list(range(1, TOUCHES + 1))),
            *((f"joint_{j + 1} [deg]", np.round(np.degrees(q[reached, j]), 5).tolist()) for j in range(6)),
            ("probe", [names[k % 3] for k in reached]),
        ]
        remarks = (
            "Simulated touches of docs/examples/arm.urdf; no real robot touched anything.",
            f"A ball on the flange sits in three sockets of a plate, each time {1e3 * TOUCH_SIGMA:g} mm off along each"
            f" axis; everything from seed {TOUCH_SEED}.",
        )
        return {"arm_touches_simulated.csv": format_table(columns, remarks)}


def _brought(robot: calib.Robot, q: Array, points: Array) -> Array:
    """Joint values near q (n, 6) [rad] that bring the ball to points (n, 3) [m], where Newton's method finds some."""
    step = 1e-6
    for _ in range(30):
        here = robot.positions(q)[:, 0]
        moved = [robot.positions(q + step * direction)[:, 0] - here for direction in np.eye(6)]
        jacobian = np.stack(moved, axis=2) / step
        change = np.einsum("nji,ni->nj", np.linalg.pinv(jacobian, rcond=1e-3), points - here)
        q = q + change * np.minimum(1.0, 0.3 / np.maximum(np.abs(change).max(axis=1, keepdims=True), 1e-12))
    return q


def five_bar() -> dict[str, str]:
    """Return the files of the five-bar."""
    robot = calib.load(EXAMPLES / "five_bar.yaml")
    rng = np.random.default_rng(FIVE_BAR_SEED)
    truth = {name: value for name, value in _drawn(robot, rng).items() if name not in robot.description.held}
    truth |= FIVE_BAR_BASE
    actual = robot.with_parameters(truth)
    poses: list[Array] = []
    while len(poses) < FIVE_BAR_POSES:
        degrees = np.round(rng.uniform([90, -20], [200, 90]), 3)
        q = np.radians(degrees)[None]
        if np.all(robot.close(q).ok) and np.all(actual.close(q).ok):
            distance = robot.singular_values(robot.assemble(q))
            if np.all(distance > 0.2) and robot.positions(q)[0, 0, 1] > 0.15:  # in front of the motors
                poses.append(q[0])
    return _files(robot, "five_bar", np.array(poses), truth, FIVE_BAR_SIGMA, FIVE_BAR_SEED, rng)


def from_template(name: str) -> dict[str, str]:
    """Return the files of a robot with loops: its URDF, its description, and its measurements."""
    texts = dict(zip((f"{name}.urdf", f"{name}.yaml"), MECHANISMS[name].files(f"{name}.urdf"), strict=True))
    with TemporaryDirectory() as folder:
        for file, text in texts.items():
            (Path(folder) / file).write_text(text)
        robot = calib.load(Path(folder) / f"{name}.yaml")
        rng = np.random.default_rng(TEMPLATE_SEED)
        truth = _drawn(robot, rng)
        actual = robot.with_parameters(truth)
        scale = np.array([_scale(robot, joint) for joint in robot.joint_names])
        candidates = np.round(calib.sample(robot, 2 * TEMPLATES[name], rng).joints * scale, 3) / scale
        near = actual.close(candidates).ok & robot.close(candidates).ok
        poses = candidates[near][: TEMPLATES[name]]
        return texts | _files(robot, name, poses, truth, TEMPLATE_SIGMA, TEMPLATE_SEED, rng)


def _drawn(robot: calib.Robot, rng: np.random.Generator) -> dict[str, float]:
    """True values: nominal plus half of what the description expects; placements stay nominal."""
    return {
        parameter.name: parameter.nominal_si + (0.0 if parameter.placement else 0.5 * parameter.sigma_si * rng.normal())
        for parameter in robot.parameters
    }


def _scale(robot: calib.Robot, joint: str) -> float:
    """What makes degrees or millimetres of a joint's SI value."""
    dimension = robot.mechanism.dimensions[joint]
    return PER_SI[dimension][DISPLAY_UNIT[dimension]]


def _files(
    robot: calib.Robot,
    name: str,
    joints: Array,
    truth: dict[str, float],
    sigma: float,
    seed: int,
    rng: np.random.Generator,
    nominal: str = "",
) -> dict[str, str]:
    actual = robot.with_parameters(truth)
    names = tuple(str(k + 1) for k in range(len(joints)))
    poses = Poses(joints, names, names, name, ())
    measured = calib.simulate(actual, poses, sigma, rng)
    comments = (
        f"Simulated measurements of docs/examples/{nominal or f'{name}.urdf'}; no real robot was measured.",
        f"Truth: {name}_truth.csv. Normal noise, sigma {1e3 * sigma:g} mm per axis; everything from seed {seed}.",
    )
    columns: list[tuple[str, list[object]]] = [("pose", list(names))]
    for joint, values in zip(robot.joint_names, joints.T, strict=True):
        unit = DISPLAY_UNIT[robot.mechanism.dimensions[joint]]
        columns.append((f"{joint} [{unit}]", [f"{value:.3f}" for value in values * _scale(robot, joint)]))
    for target, points in zip(robot.target_names, 1e3 * measured.points(robot).transpose(1, 2, 0), strict=True):
        for axis, millimetres in zip("xyz", points, strict=True):
            columns.append((f"{target}_{axis} [mm]", [f"{value:.4f}" for value in millimetres]))
    return {
        f"{name}_simulated.csv": format_table(columns, comments),
        f"{name}_truth.csv": parameter_file(actual),
    }


def parameter_file(robot: calib.Robot) -> str:
    """Return a robot's values as a parameter file."""
    values = [float(value * p.per_si) for p, value in zip(robot.parameters, robot.values, strict=True)]
    names, units = [p.name for p in robot.parameters], [p.unit for p in robot.parameters]
    return format_table([("parameter", names), ("value", values), ("unit", units)])


def every_file() -> dict[str, str]:
    """Return all files that are made, by name."""
    files = arm() | ur10e() | touches() | five_bar()
    for name in TEMPLATES:
        files |= from_template(name)
    return files


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", metavar="FOLDER", nargs="?", type=Path, default=EXAMPLES, help="where to write")
    folder = parser.parse_args().folder
    for name, text in every_file().items():
        (folder / name).write_text(text, encoding="utf-8")
        print(f"{folder / name} written")


if __name__ == "__main__":
    main()
