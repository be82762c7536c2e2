"""What hand-eye calibrations promise, in simulated set-ups: held-out error, coverage, and how often PASS is wrong.

    python -m tests.photographs.hand_eye_set_ups --count 1000 [--errors joints|images|both] [--seed 1] [--minutes 60]

Each set-up draws one of four robots (published Denavit-Hartenberg tables), the side of the camera, 8 to 40 images and
0.1 to 1 px of noise. `joints`: the robot's lengths and angles are off, so that errors follow its pose as those of real
robots do; `images`: the tool is off at each image, independently, which is what intervals assume. New images of the
same kind say what is true: a set-up whose PASS promises less than they have is a false one. Kinematics, pixels and the
board are plain matrix products, as in `camera_scenes`. Plain least squares that knows the true lens is the reference.

A line for each set-up, and a table at the end: parts of the set-ups with 95 % intervals (Clopper and Pearson; those of
the camera's six numbers from the spread between set-ups, as the six of one are not independent).
"""

import argparse
import sys
import time
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import binomtest, t

from calib.core.base.errors import CalibrationError
from calib.photographs.estimation import plain, rms
from calib.photographs.hand_eye import calibrate
from calib.photographs.hand_eye_result import judge
from calib.photographs.scene import HandEyePlacement, plane_errors_on_board
from tests.photographs.camera_scenes import BOARD, CAMERA, INTRINSICS, pixels_from, pose, scene_of_pixels, tools

TABLES = {
    "UR5": [(0.089159, 0, 1), (0, -0.425, 0), (0, -0.39225, 0), (0.10915, 0, 1), (0.09465, 0, -1), (0.0823, 0, 0)],
    "UR10": [(0.1273, 0, 1), (0, -0.612, 0), (0, -0.5723, 0), (0.163941, 0, 1), (0.1157, 0, -1), (0.0922, 0, 0)],
    "Puma 560": [(0.6718, 0, 1), (0, 0.4318, 0), (0.15005, 0.0203, -1), (0.4318, 0, 1), (0, 0, -1), (0.05, 0, 0)],
    "IRB 1600": [(0.4865, 0.15, -1), (0, 0.475, 0), (0, 0, -1), (0.6, 0, 1), (0, 0, -1), (0.065, 0, 0)],
}
"""Standard Denavit-Hartenberg numbers: d, a [m], and alpha in right angles."""
LENGTH_OFF, ANGLE_OFF = 0.3e-3, 0.4e-3  # m, rad: each number of a table
SHIFT_OFF, TURN_OFF = 0.3e-3, 0.3e-3  # of the tool, per axis
REPEATABILITY = 20e-6  # m per axis, and five times as many rad
NEW = 60  # images that say what is true
_PLACES = 30  # tried for a robot
_NEWTON_STEPS = 60


def table(name):
    """Theta, d, a, alpha of a robot, (6, 4)."""
    return np.array([(0.0, d, a, alpha * np.pi / 2) for d, a, alpha in TABLES[name]])


def links_of(row, angles):
    """The frames of one joint's table row at angles (n,), (n, 4, 4)."""
    offset, d, a, alpha = row
    c, s, ca, sa = np.cos(angles + offset), np.sin(angles + offset), np.cos(alpha), np.sin(alpha)
    none, full = np.zeros_like(c), np.ones_like(c)
    rows = [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s]]
    rows += [[none, sa * full, ca * full, d * full], [none, none, none, full]]
    return np.moveaxis(np.array(rows), 2, 0)


def frames(numbers, q):
    """The base and what follows each joint, at joint values (n, 6): seven times (n, 4, 4)."""
    result = [np.tile(np.eye(4), (len(q), 1, 1))]
    for row, angles in zip(numbers, q.T, strict=True):
        result.append(result[-1] @ links_of(row, angles))
    return result


def joints_of(numbers, ideal, q):
    """Joint values (n, 6) that bring the tool to poses (n, 4, 4), by damped Newton steps; None where none are found."""
    q = np.tile(q, (len(ideal), 1))
    for _ in range(_NEWTON_STEPS):
        *axes, there = frames(numbers, q)
        off = np.concatenate([ideal[:, :3, 3] - there[:, :3, 3], turns(ideal[:, :3, :3], there[:, :3, :3])], axis=1)
        if np.max(np.abs(off)) < 1e-10:
            return q
        z = np.stack([frame[:, :3, 2] for frame in axes], axis=1)
        arm = there[:, None, :3, 3] - np.stack([frame[:, :3, 3] for frame in axes], axis=1)
        slope = np.concatenate([np.cross(z, arm), z], axis=2).transpose(0, 2, 1)
        inner = slope @ slope.transpose(0, 2, 1) + 1e-9 * np.eye(6)
        step = np.einsum("nij,ni->nj", slope, np.linalg.solve(inner, off[:, :, None])[:, :, 0])
        q = q + step * np.minimum(1.0, 0.5 / np.maximum(np.max(np.abs(step), axis=1, keepdims=True), 1e-300))
    return None


def turns(goal, there):
    """The rotation vectors in the base from orientations there to those of goals, (n, 3)."""
    return Rotation.from_matrix(goal @ there.transpose(0, 2, 1)).as_rotvec()


def reached(numbers, ideal, generator):
    """Joint values for tool poses of a robot that stands somewhere, and where; None if no place was found."""
    for _ in range(_PLACES):
        q = generator.uniform([-2, -2, -2, -2, 0.6, -2], [2, 0, 2, 2, 1.6, 2])
        base = ideal[0] @ np.linalg.inv(frames(numbers, q[None])[-1][0])
        joints = joints_of(numbers, np.linalg.inv(base) @ ideal, q)
        if joints is not None:
            return joints, base
    return None


def drawn(generator, errors, n, mount, robot, sigma):
    """Images of a set-up, n of them, and where camera and board are; None where the robot cannot take them."""
    nominal = table(robot)
    place = reached(nominal, tools(n, mount, generator)[0], generator)
    if place is None:
        return None
    joints, base = place
    real = nominal.copy()
    if errors == "joints":
        real[:, [1, 2]] += LENGTH_OFF * generator.standard_normal((6, 2))
        real[:, [0, 3]] += ANGLE_OFF * generator.standard_normal((6, 2))
    twists = REPEATABILITY * generator.standard_normal((n, 6)) * [1, 1, 1, 5, 5, 5]
    if errors == "images":
        twists = generator.standard_normal((n, 6)) * np.repeat([SHIFT_OFF, TURN_OFF], 3)
    there = frames(real, joints)[-1] @ np.array([pose(twist[:3], np.rad2deg(twist[3:])) for twist in twists])
    on_base = np.linalg.inv(base) @ (CAMERA if mount == "base" else BOARD)[mount]
    camera, board = (on_base, BOARD[mount]) if mount == "base" else (CAMERA[mount], on_base)
    views = np.linalg.inv(camera) @ (there if mount == "base" else np.linalg.inv(there)) @ board
    pixels = pixels_from(views)
    pixels += sigma * generator.standard_normal(pixels.shape)
    scene = scene_of_pixels(frames(nominal, joints)[-1], pixels, mount)
    return scene, HandEyePlacement(camera, board, INTRINSICS)


def covered(fitted, camera):
    """Which of the camera's six numbers lie in their intervals."""
    step = np.linalg.inv(fitted.placed.camera) @ camera
    off = np.r_[step[:3, 3], Rotation.from_matrix(step[:3, :3]).as_rotvec()]
    half = t.ppf(0.975, fitted.freedom[:6]) * np.sqrt(np.diag(fitted.covariance)[:6])
    return np.abs(off) <= half


@dataclass(frozen=True)
class Line:
    """What one set-up gave.

    Attributes:
        over_plain: Error at new images over that of plain least squares.
        inside: Which of the camera's six numbers lie in their 95 % intervals.
        over_limit: Error at as many new images as were used over what is promised.
        grade: PASS, CHECK or FAIL.
    """

    over_plain: float
    inside: np.ndarray
    over_limit: float
    grade: str


def tried(number, errors, seed):
    """The line of a set-up; None where the robot cannot take the images."""
    generator = np.random.default_rng([seed, number])
    robot, mount = list(TABLES)[number % 4], ("tool", "base")[number // 4 % 2]
    n, sigma = int(generator.integers(8, 41)), float(np.exp(generator.uniform(np.log(0.1), 0.0)))
    case = drawn(generator, errors, n + NEW, mount, robot, sigma)
    if case is None:
        return None
    every, real = case
    order = generator.permutation(n + NEW)
    own = every.select_images(np.isin(np.arange(n + NEW), order[:n]))
    new = every.select_images(np.isin(np.arange(n + NEW), order[n:]))
    result = calibrate(own, INTRINSICS, mounts=(mount,))
    reference = plain(own, real).placed
    off = rms(plane_errors_on_board(new, result.fitted.placed))
    line = Line(
        off / rms(plane_errors_on_board(new, reference)),
        covered(result.fitted, real.camera),
        rms(plane_errors_on_board(new.select_images(np.arange(NEW) < n), result.fitted.placed)) / result.limit,
        judge(result).grade,
    )
    words = ["lens found"] * result.lens_found + ["weighed"] * result.weighed
    words += [f"{len(result.outlying_images)} set aside"] * bool(result.outlying_images) + [
        mistake.code for mistake in result.mistakes
    ]
    print(
        f"{number} {errors} {robot} {mount} n {n} {sigma:.2f} px: new {1e3 * off:.3f} mm, left out"
        f" {1e3 * rms(result.left_out.board):.3f}, limit {1e3 * result.limit:.3f}, over plain {line.over_plain:.3f},"
        f" inside {np.sum(line.inside)} of 6, {', '.join([line.grade, *words])}",
        flush=True,
    )
    return line


def part(count, total):
    """How many of how many, in words, with the 95 % interval."""
    if total == 0:
        return "none of none"
    low, high = (100 * value for value in binomtest(count, total).proportion_ci())
    return f"{count} of {total}, {100 * count / total:.1f} % ({low:.1f} to {high:.1f})"


def tell(errors, lines):
    """Print the table of the set-ups with one kind of errors."""
    ratios = np.array([line.over_plain for line in lines])
    passed = [line for line in lines if line.grade == "PASS"]
    inside = np.array([np.mean(line.inside) for line in lines])
    half = 1.96 * np.std(inside, ddof=1) / np.sqrt(len(inside)) if len(inside) > 1 else np.nan
    print(f"\nerrors of {errors}: {len(lines)} set-ups, {len(passed)} PASS")
    print(f"  error at new images over plain least squares: median {np.median(ratios):.3f}, largest {ratios.max():.3f}")
    print(f"  more than 2 % worse: {part(int(np.sum(ratios > 1.02)), len(ratios))}")
    print(f"  more than 2 % better: {part(int(np.sum(ratios < 0.98)), len(ratios))}")
    print(f"  camera within its 95 % intervals: {100 * np.mean(inside):.1f} % of its numbers (± {100 * half:.1f})")
    print(f"  limit exceeded: {part(sum(line.over_limit > 1 for line in lines), len(lines))}")
    print(f"  limit exceeded, of PASS: {part(sum(line.over_limit > 1 for line in passed), len(passed))}")
    far = [line.over_limit for line in passed if line.over_limit > 1]
    if far:
        print(f"    there by {100 * (np.median(far) - 1):.0f} % in the middle, at most {100 * (max(far) - 1):.0f} %")


def main(count, errors, seed, minutes):
    end, failed, unreached = time.monotonic() + 60 * minutes, 0, 0
    lines = {name: [] for name in (("joints", "images") if errors == "both" else (errors,))}
    for number in range(count):
        if time.monotonic() > end:
            break
        kind = list(lines)[number // 8 % len(lines)]
        try:
            line = tried(number, kind, seed)
        except CalibrationError as error:
            failed += 1
            print(f"{number}: {error}", file=sys.stderr)
            continue
        unreached += line is None
        if line is not None:
            lines[kind].append(line)
    print(f"\nseed {seed}; {failed} could not be calibrated, {unreached} robots could not take the images")
    for name, own in lines.items():
        if own:
            tell(name, own)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=200, help="set-ups")
    parser.add_argument("--errors", choices=["joints", "images", "both"], default="both", help="what is off")
    parser.add_argument("--seed", type=int, default=1, help="of all")
    parser.add_argument("--minutes", type=float, default=np.inf, help="begin no set-up after so long")
    given = parser.parse_args()
    main(given.count, given.errors, given.seed, given.minutes)
