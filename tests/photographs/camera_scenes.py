"""Simulated hand-eye set-ups, by plain matrix products that share no code with the engine's solver."""

import numpy as np
from scipy.spatial.transform import Rotation

from calib.photographs.scene import BoardScene

SQUARE = 0.045
INTRINSICS = np.array([900.0, 905.0, 655.0, 470.0, -0.1, 0.05, 0.0, 0.0, 0.0])
SIZE = (1280, 960)


def pose(xyz, degrees):
    result = np.eye(4)
    result[:3, :3] = Rotation.from_euler("xyz", degrees, degrees=True).as_matrix()
    result[:3, 3] = xyz
    return result


CAMERA = {"tool": pose((0.04, -0.06, 0.09), (3, -4, 90)), "base": pose((0.2, 1.3, 0.6), (100, 5, -170))}
BOARD = {"tool": pose((0.6, -0.1, 0.0), (178, 3, 20)), "base": pose((0.01, -0.07, 0.12), (8, -10, 15))}


def pixels_of(points, intrinsics=INTRINSICS):
    """OpenCV's published formula, written out once more."""
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = intrinsics
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    yd = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    return np.stack([fx * xd + cx, fy * yd + cy], axis=1)


def board_points(columns=5, rows=6, square=SQUARE):
    return np.array([((i + 1) * square, (j + 1) * square, 0.0) for j in range(rows - 1) for i in range(columns - 1)])


def pixels_from(views, intrinsics=INTRINSICS):
    """Pixels of the board's points, one view after the other; views are poses of the board in the camera."""
    body = board_points()
    return np.concatenate([pixels_of(body @ view[:3, :3].T + view[:3, 3], intrinsics) for view in views])


def tools(n, mount, generator, tilt=28.0):
    """Tool poses from which the camera sees the board, and the board in the camera at each."""
    middle, result, seen = board_points().mean(axis=0), [], []
    for k in range(n):
        angle = 2 * np.pi * k / n + generator.uniform(-0.3, 0.3)
        view = pose((0, 0, 0), (tilt * np.cos(angle), tilt * np.sin(angle), generator.uniform(-60, 60)))
        at = np.array([*generator.uniform(-0.08, 0.08, 2), generator.uniform(0.4, 0.65)])
        view[:3, 3] = at - view[:3, :3] @ middle
        seen.append(view)
        if mount == "tool":
            result.append(BOARD[mount] @ np.linalg.inv(view) @ np.linalg.inv(CAMERA[mount]))
        else:
            result.append(CAMERA[mount] @ view @ np.linalg.inv(BOARD[mount]))
    return np.array(result), np.array(seen)


def scene(n=12, mount="tool", seed=0, noise=0.2, shift=0.0, turn=0.0, intrinsics=INTRINSICS):
    """A set-up whose robot is off by shift [m] and turn [rad] per axis at each image."""
    generator = np.random.default_rng(seed)
    real, seen = tools(n, mount, generator)
    pixels = pixels_from(seen, intrinsics)
    pixels = pixels + noise * generator.standard_normal(pixels.shape)
    told = np.array(
        [T @ pose(shift * generator.standard_normal(3), np.rad2deg(turn * generator.standard_normal(3))) for T in real]
    )
    return scene_of_pixels(told, pixels, mount)


def scene_of_pixels(told, pixels, mount):
    """Images with poses of the tool as told, (n, 4, 4), that all show the whole board."""
    n, body = len(told), board_points()
    names = tuple(f"shot_{k + 1:02d}" for k in range(n))
    return BoardScene(names, told, np.repeat(np.arange(n), len(body)), np.tile(body, (n, 1)), pixels, mount, SIZE)
