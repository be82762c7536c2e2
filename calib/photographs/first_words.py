"""`calib init --measure camera`: the likely pose of the board, and its entry in the description."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray
from calib.core.base.units import quantity_text
from calib.core.instruments.camera import NAMES
from calib.core.robots.robot import Robot
from calib.photographs.camera_files import read_camera
from calib.photographs.commands.boards import read_board_option

_BOARD = "charuco:7x5:30mm:22mm:DICT_5X5_100"
_IMAGE, _FOCAL = (1280, 960), 1000.0  # px, without a camera file
_OFF_GUESSED, _OFF_GIVEN = 0.1, 0.01  # relative uncertainty of the focal length
_AWAY = 1.8  # distance of board and camera in diagonals of the board
_TRIED, _PLACES = 600, 60  # sampled poses, and how many of them place a candidate board
_AHEAD, _FACING = 0.93, 0.6  # least cosines of the line of sight to the camera's axis and to the board's normal


def camera_words(
    robot: Robot, board: str | None, camera: str | None, to_print: Path | None, out: Path
) -> tuple[dict[Path, bytes], dict[str, str]]:
    """Return the board's file, unless it exists, and the entries of board and camera in the description at `out`.

    The robot has neither board nor camera yet; `board` and `camera` are the user's options.
    """
    described = read_board_option(_BOARD if board is None else board)
    if camera is None:
        middle_u, middle_v = ((length - 1) / 2 for length in _IMAGE)
        intrinsics = np.array([_FOCAL, _FOCAL, middle_u, middle_v, 0, 0, 0, 0, 0])
        image, off = _IMAGE, _OFF_GUESSED * _FOCAL
    else:
        given = read_camera(camera)
        intrinsics, image = given.intrinsics, given.image or _IMAGE
        off = _OFF_GIVEN * intrinsics[0]
    numbers = {name: float(f"{value:.8g}") for name, value in zip(NAMES, intrinsics, strict=True)}
    free = {name: float(f"{off:.2g}") for name in NAMES[:4]} | dict.fromkeys(NAMES[4:6], 0.1)
    middle = np.array([*described.size, 0.0]) / 2
    away = _AWAY * float(np.hypot(*described.size)) * max(1.0, intrinsics[0] / max(image))
    xyz, rpy = _about_seen(robot, middle, away)
    path = to_print if to_print is not None else Path(str(board))
    words = {
        "board_file": json.dumps(os.path.relpath(path.resolve(), out.resolve().parent), ensure_ascii=False),
        "board_text": str(described),
        "board_xyz": f"[{', '.join(quantity_text(value, 'mm', '.0f') for value in xyz)}]",
        "board_rpy": f"[{', '.join(quantity_text(value, 'deg', '.0f') for value in rpy)}]",
        "image": str(list(image)),
        "intrinsics": _yaml(numbers),
        "unknown_intrinsics": _yaml(free),
    }
    if to_print is None:
        return {}, words
    values = described.model_dump(exclude_none=True, exclude_defaults=True)
    lines = [
        f"{key}: {quantity_text(value, 'mm', '.9g') if isinstance(value, float) else value}"
        for key, value in values.items()
    ]
    comment = "# A printed board: measure what you have, or print this one (calib board).\n"
    return {to_print: (comment + "\n".join(lines) + "\n").encode()}, words


def _yaml(values: Mapping[str, float]) -> str:
    return "{" + ", ".join(f"{name}: {value:.10g}" for name, value in values.items()) + "}"


def _about_seen(robot: Robot, middle: FloatArray, away: float) -> tuple[FloatArray, FloatArray]:
    """Pose of the board that most sampled poses see, if the camera looks along z of the target: xyz [m], rpy [rad]."""
    poses = robot.forward(robot.sample(_TRIED, 0))
    boards = poses[:_PLACES].copy()
    boards[:, :3, 3] += away * boards[:, :3, 2]
    apart = boards[:, None, :3, 3] - poses[None, :, :3, 3]
    distance = np.maximum(np.linalg.norm(apart, axis=2), 1e-9)
    ahead = np.einsum("bka,ka->bk", apart, poses[:, :3, 2]) / distance
    facing = np.einsum("bka,ba->bk", apart, boards[:, :3, 2]) / distance
    visible = (ahead > _AHEAD) & (facing > _FACING) & (distance > 0.7 * away) & (distance < 1.6 * away)
    best = boards[int(np.argmax(np.sum(visible, axis=1)))]
    corner = np.round(best[:3, 3] - best[:3, :3] @ middle, 2) + 0.0
    angles = scipy.spatial.transform.Rotation.from_matrix(best[:3, :3]).as_euler("xyz")
    return corner, np.deg2rad(np.round(np.rad2deg(angles))) + 0.0
