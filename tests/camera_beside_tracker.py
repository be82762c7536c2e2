"""What a camera on the flange reaches beside a laser tracker, at the same poses: simulated, and printed as a table.

    python -m tests.camera_beside_tracker [--draws N] [--seed N]

Robots of docs/examples, described by `calib init --measure camera` and `--measure tracker`. Lengths and angles of the
true robot are off by 0.5 mm and 1.5 mrad, where camera and board are by 5 mm and 0.5 deg. The camera (640 x 480 px,
focal length 610 px, within 1 %) finds corners of the printed board with 0.1 px of noise, the tracker reads 0.03 mm per
axis. How far off the flange is at 200 other poses counts base and tool placed as well as possible: no camera on the
robot sees where the base is in the room.
"""

from __future__ import annotations

import argparse
import contextlib
import io
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pinocchio as pin
import scipy

import calib
from calib.starting.command import command
from tests.project import EXAMPLES

ROBOTS = {"arm": [str(EXAMPLES / "arm.urdf")], "UR10e": ["--dh", str(EXAMPLES / "ur10e_dh.csv")]}
CAMERA = """\
image_width: 640
image_height: 480
camera_matrix: {rows: 3, cols: 3, data: [610, 0, 319.5, 0, 610, 239.5, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}
"""
COUNTS = (20, 40, 80)
LENGTH, ANGLE, PLACE, TURN = 0.5e-3, 1.5e-3, 5e-3, np.deg2rad(0.5)
PIXELS, TRACKER = 0.1, "0.03 mm"


def described(folder: Path, name: str, measure: str) -> calib.Robot:
    """A robot as `calib init` describes it."""
    path = folder / f"{measure}.yaml"
    (folder / "camera_info.yaml").write_text(CAMERA)
    lens = ["--camera", str(folder / "camera_info.yaml")] if measure == "camera" else []
    with contextlib.redirect_stdout(io.StringIO()):
        command([*ROBOTS[name], "--measure", measure, *lens, "--out", str(path)], standalone_mode=False)
    text = path.read_text()
    if measure == "camera":
        text = text.replace("# sigma: 0.2  ", f"sigma: {PIXELS}  ")
    path.write_text(text.replace("sigma: {range: 0.02 mm, angle: 0.01 mrad}", f"sigma: {TRACKER}"))
    return calib.load(path)


def drawn(robot: calib.Robot, rng: np.random.Generator) -> calib.Robot:
    """The true robot."""
    values = {}
    for parameter in robot.parameters[: robot.n_origin_parameters]:
        own, _, part = parameter.name.rpartition(".")
        if parameter.name in robot.description.held:
            continue
        apart = own in ("board", "camera", "reflector", "base")
        size = (TURN if apart else ANGLE) if part.startswith("r") else (PLACE if apart else LENGTH)
        values[parameter.name] = parameter.nominal_si + size * rng.standard_normal()
    return robot.with_parameters(values)


def flange_error(estimate: calib.Robot, true: calib.Robot, q: np.ndarray) -> float:
    """Root mean square of how far off the flange is, base and tool placed as well as possible [mm]."""
    at, expected = estimate.forward(q, "flange"), true.forward(q, "flange")[:, :3, 3]

    def off(x: np.ndarray) -> np.ndarray:
        base = pin.exp6(x[:6])
        points = at[:, :3, 3] + at[:, :3, :3] @ x[6:]
        return (points @ base.rotation.T + base.translation - expected).ravel()

    left = scipy.optimize.least_squares(off, np.zeros(9)).fun.reshape(-1, 3)
    return float(1e3 * np.sqrt(np.mean(np.sum(left**2, axis=1))))


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--draws", type=int, default=5, help="true robots for each line (default: 5)")
    parser.add_argument("--seed", type=int, default=0, help="of everything random (default: 0)")
    arguments = parser.parse_args()
    print("| robot | poses | nominal [mm] | camera [mm] | tracker [mm] |\n|---|---:|---:|---:|---:|")
    for name in ROBOTS:
        with TemporaryDirectory() as folder:
            robots = {measure: described(Path(folder), name, measure) for measure in ("camera", "tracker")}
            for count in COUNTS:
                rows = [_errors(robots, count, [arguments.seed, draw]) for draw in range(arguments.draws)]
                nominal, camera, tracker = np.sqrt(np.mean(np.square(rows), axis=0))
                print(f"| {name} | {count} | {nominal:.2f} | {camera:.3f} | {tracker:.3f} |", flush=True)


def _errors(robots: dict[str, calib.Robot], count: int, seed: list[int]) -> tuple[float, float, float]:
    rng = np.random.default_rng(seed)
    true = drawn(robots["camera"], rng)
    values = dict(zip((p.name for p in true.parameters), true.values, strict=True))
    own = robots["tracker"]
    joints = {p.name: values[p.name] for p in own.parameters[: own.n_origin_parameters] if p.name in values}
    measured_by = {"camera": true, "tracker": own.with_parameters(joints)}
    poses = calib.sample(robots["camera"], count, seed=seed[1])
    elsewhere = calib.sample(robots["camera"], 200, seed=1000 + seed[1]).joints
    errors = []
    for measure, robot in robots.items():
        data = calib.simulate(measured_by[measure], poses.joints, None, rng)
        errors.append(flange_error(calib.fit(robot, data).robot, true, elsewhere))
    return (flange_error(robots["camera"], true, elsewhere), errors[0], errors[1])


if __name__ == "__main__":
    main()
