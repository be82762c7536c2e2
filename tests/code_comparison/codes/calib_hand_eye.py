"""This project, as `calib hand-eye` does from photographs and poses; corners are given, as to all codes."""

import sys

import numpy as np
from exchange import Answer, Photographs, fit_time, main

import calib
from calib.photographs.estimation import rms
from calib.photographs.hand_eye import calibrate
from calib.photographs.hand_eye_result import judge
from calib.photographs.scene import BoardScene


def solve(problem: Photographs) -> Answer:
    # -- what a user writes, or in one line: calib hand-eye FOLDER --board BOARD --poses FILE --camera FILE
    names = tuple(str(k) for k in range(len(problem.tool)))
    scene = BoardScene(names, problem.tool, problem.image, problem.corners, problem.pixels, "base", problem.size)
    with fit_time():
        result = calibrate(scene, np.array([*problem.intrinsics, 0, 0, 0, 0, 0]), mounts=("base",))
    # -- end
    placed = result.fitted.placed
    lens = placed.intrinsics[[0, 1, 2, 3, 4, 5]]
    version = f"this project {calib.__version__} (lens {'found' if result.lens_found else 'as published'})"
    left = rms(result.left_out.pixels)
    return Answer(problem.predicted(placed.camera, placed.board, lens), left, True, judge(result).grade, version)


if __name__ == "__main__":
    sys.exit(main(solve, Photographs))
