"""What `calib hand-eye` makes of the ChArUco set of ros-industrial/industrial_calibration, beside plain least squares.

    python tests/hand_eye_figures.py FOLDER

FOLDER has images/*.png, poses.csv (pose, x, y, z, qx, qy, qz, qw) and cal.yaml with the intrinsics as published. The
reference is scipy's least squares without weights on the same corners.
"""

import argparse
import time
from pathlib import Path

import numpy as np
import yaml

from calib.photographs.commands.boards import given_board
from calib.photographs.detection import detect
from calib.photographs.hand_eye_calibration import calibrate
from calib.photographs.images import shots
from calib.photographs.left_out import rms
from calib.photographs.scene import scene_of
from calib.photographs.tool_poses import read_tool_poses

BOARD = "charuco:5x7:36.195mm:18.256mm:DICT_6X6_250"
REFERENCE = {"given": (2.668, 3.338, 1.420, 1.822), "found": (1.128, 1.538, 0.619, 0.886)}


def main(folder: Path) -> None:
    started = time.perf_counter()
    board = given_board(BOARD)
    *_, detected = detect(board, ((image.name, image.read()) for image in shots([str(folder / "images")])))
    print(f"{detected.n_points} corners: {' '.join(str(len(image.points)) for image in detected.images)}")
    names, tool = read_tool_poses(folder / "poses.csv")
    scene = scene_of(detected.usable, board, np.array([tool[names.index(image.name)] for image in detected.usable]))
    given = yaml.safe_load((folder / "cal.yaml").read_text())["intrinsics"]
    intrinsics = np.array([*(given[key] for key in ("fx", "fy", "cx", "cy")), 0, 0, 0, 0, 0])
    for lens, reference in REFERENCE.items():
        result = calibrate(scene, intrinsics, lens=lens)
        own = rms(result.pixels), rms(result.left.pixels), 1e3 * rms(result.board), 1e3 * rms(result.left.board)
        print(f"{lens}: px {own[0]:.3f}, left out {own[1]:.3f}; mm {own[2]:.3f}, left out {own[3]:.3f}")
        print("   over the reference: " + ", ".join(f"{a / b:.4f}" for a, b in zip(own, reference, strict=True)))
        print(f"   camera alone {rms(result.alone):.3f} px; {[mistake.code for mistake in result.mistakes]}")
    print(f"{time.perf_counter() - started:.1f} s")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", metavar="FOLDER", type=Path, help="with images, poses.csv and cal.yaml")
    main(parser.parse_args().folder)
