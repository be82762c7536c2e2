"""Other meanings of the poses and board of a hand-eye calibration, each a usual mistake in files.

    pairs shifted     images belong to the poses one or two rows later or earlier
    mirrored          the camera mirrors its images (a chessboard does not show it)
    poses inverted    the file has the base in the tool. With the other mount, the same images fit as well: this shows
                      only if the mount is stated
    rotations         the numbers of a rotation in another order, or of the base in the tool
    units             lengths of poses and board differ by a factor between units

A rotation is converted back to the numbers of the file, which are then read in another way.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray
from calib.photographs.scene import BoardScene, Mount

_SHIFTS = (1, -1, 2, -2)
_FEWEST = 4  # images
_UNITS = (10.0, 0.1, 1000.0, 0.001)


def other_readings(scene: BoardScene, mounts: tuple[Mount, ...]) -> Iterator[tuple[str, str, BoardScene]]:
    """Yield code and words of a mistake, and the scene with that other meaning of its numbers."""
    n = len(scene)
    for shift in _SHIFTS:
        pairs = np.arange(n) + shift
        paired = (pairs >= 0) & (pairs < n)
        if np.sum(paired) < _FEWEST:
            continue
        tool = scene.tool.copy()
        tool[paired] = scene.tool[pairs[paired]]
        rows = "row" if abs(shift) == 1 else "rows"
        text = (
            f"images and poses are shifted: each image fits the pose {abs(shift)} {rows}"
            f" {'further on' if shift > 0 else 'before'}"
        )
        yield "pairs_shifted", text, replace(scene, tool=tool).select_images(paired)
    mirrored = replace(scene, pixels=scene.pixels * [-1, 1] + [scene.size[0] - 1, 0])
    yield "mirrored", "the images are mirrored; flip them, or switch that off in the camera", mirrored
    if len(mounts) == 1:
        text = "the poses are inverted: the base in the tool, not the tool in the base"
        yield "poses_inverted", text, replace(scene, tool=np.linalg.inv(scene.tool))
    for text, tool in _other_rotations(scene.tool):
        yield "rotations", text, replace(scene, tool=tool)
    for factor in _UNITS:
        text = (
            f"the board would be {factor:.4g} times as large as described: lengths of the board or of the poses are in"
            f" another unit than the files say"
        )
        yield "units", text, replace(scene, body=factor * scene.body)


def _other_rotations(tool: FloatArray) -> Iterator[tuple[str, FloatArray]]:
    """Yield a mistake in the rotations in words, and the corrected tool poses, (n, 4, 4)."""
    of = scipy.spatial.transform.Rotation
    read = of.from_matrix(tool[:, :3, :3])
    quaternions, angles = read.as_quat(), read.as_euler("xyz")
    ways = {
        "the rotations are inverted: of the base in the tool, while positions are of the tool in the base": read.inv(),
        "the quaternions have their real part first: name their columns qw, qx, qy, qz": of.from_quat(
            np.roll(quaternions, -1, axis=1)
        ),
        "the quaternions have their real part last: name their columns qx, qy, qz, qw": of.from_quat(
            np.roll(quaternions, 1, axis=1)
        ),
        "the angles turn about x, the new y and the new z, but were read about the fixed x, y and z (the same as about"
        " z, the new y and the new x): give quaternions": of.from_euler("XYZ", angles),
        "the first angle is about z, and the last about x: exchange the names of their columns": of.from_euler(
            "xyz", angles[:, ::-1]
        ),
    }
    for text, rotation in ways.items():
        other = tool.copy()
        other[:, :3, :3] = rotation.as_matrix()
        yield text, other
