"""OpenCV: `solvePnP` for each image, then `calibrateHandEye` or `calibrateRobotWorldHandEye`, as documented.

Every method is tried, with intrinsics as published and with those of `calibrateCamera`; the one that leaves least in
the images fitted answers. For a camera beside the robot, `calibrateHandEye` gets the inverse poses of the robot; the
board on the tool is then the mean of what the images say.
"""

import sys

import cv2
import numpy as np
from exchange import Answer, Photographs, fit_time, main, moved, seen
from scipy.spatial.transform import Rotation

# -- what a user writes
HAND_EYE = {"Tsai": cv2.CALIB_HAND_EYE_TSAI, "Park": cv2.CALIB_HAND_EYE_PARK, "Horaud": cv2.CALIB_HAND_EYE_HORAUD,
            "Andreff": cv2.CALIB_HAND_EYE_ANDREFF, "Daniilidis": cv2.CALIB_HAND_EYE_DANIILIDIS}  # fmt: skip
ROBOT_WORLD = {"Shah": cv2.CALIB_ROBOT_WORLD_HAND_EYE_SHAH, "Li": cv2.CALIB_ROBOT_WORLD_HAND_EYE_LI}
RADIAL = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3


def parts(poses):
    return poses[:, :3, :3], poses[:, :3, 3, None]


def joined(turn, shift):
    return moved(turn, np.asarray(shift).ravel())


def lenses(problem, images):
    """Intrinsics as published, and by OpenCV from the images; with distortion k1 k2 p1 p2."""
    matrix = np.array([[problem.intrinsics[0], 0, problem.intrinsics[2]],
                       [0, problem.intrinsics[1], problem.intrinsics[3]], [0, 0, 1.0]])  # fmt: skip
    yield matrix, np.zeros(5)
    corners, pixels = ([part.astype(np.float32) for part in per_image] for per_image in zip(*images, strict=True))
    _, fitted, bend, *_ = cv2.calibrateCamera(corners, pixels, problem.size, matrix.copy(), np.zeros(5), flags=RADIAL)
    yield fitted, bend.ravel()


def solutions(problem, which):
    """Camera in the base, board on the tool, lens, and the method."""
    rows = [np.flatnonzero(problem.image == k) for k in range(len(problem.tool))]
    used = [k for k, own in enumerate(rows) if len(own) >= 6]
    images = [(problem.corners[rows[k]], problem.pixels[rows[k]]) for k in used]
    tool = problem.tool[used]
    for matrix, bend in lenses(problem, images):
        lens = np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *bend[:2]])
        told = [cv2.solvePnP(corners, pixels, matrix, bend)[1:] for corners, pixels in images]
        T_camera_board = np.array([joined(cv2.Rodrigues(turn)[0], shift) for turn, shift in told])
        if which == "hand-eye":
            for name, method in HAND_EYE.items():
                transforms = cv2.calibrateHandEye(*parts(np.linalg.inv(tool)), *parts(T_camera_board), method=method)
                camera = joined(*transforms)
                boards = np.linalg.inv(tool) @ camera @ T_camera_board
                turn = Rotation.from_matrix(boards[:, :3, :3]).mean().as_matrix()
                yield camera, joined(turn, boards[:, :3, 3].mean(axis=0)), lens, name
        else:
            for name, method in ROBOT_WORLD.items():
                transforms = cv2.calibrateRobotWorldHandEye(*parts(T_camera_board), *parts(tool), method=method)
                yield np.linalg.inv(joined(*transforms[2:])), np.linalg.inv(joined(*transforms[:2])), lens, name


def solve(problem: Photographs, which: str) -> Answer:
    best = np.inf, None
    with fit_time():
        for *placed, name in solutions(problem, which):
            misses = seen(problem.tool[problem.image], problem.corners, *placed) - problem.pixels
            left = float(np.sqrt(2 * np.mean(misses**2)))
            if left < best[0]:
                best = left, (*placed, name)
    # -- end
    left, (*placed, name) = best
    return Answer(problem.predicted(*placed), left, package=f"OpenCV {cv2.__version__} ({name})")


if __name__ == "__main__":
    sys.exit(main(solve, Photographs))
