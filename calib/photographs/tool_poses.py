"""Poses of a robot's tool as teach pendants show them: position, and a quaternion or three angles.

Columns (with units in the header; m and rad without):

    x, y, z               the tool in the robot's base
    qx, qy, qz, qw        unit quaternion; or q1, q2, q3, q4 with the real part first, as ABB has it
    roll, pitch, yaw      rotations about the fixed axes x, y, z in this order, as URDF has it
    w, p, r               the same, in Fanuc's names
    a, b, c               about z, then the new y, then the new x, in KUKA's names
    r11, r12, ... r33     a rotation matrix, row by row; of 4 x 4 matrices, 00 to 23 in place of x, y, z and r11 to r33
    rx, ry, rz            a rotation vector (Universal Robots), or roll, pitch, yaw: the user must state which

A column `image` (the file) or `pose` (its name without suffix) has the image of each row.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import DataError, nearest
from calib.core.base.units import Dimension
from calib.core.data.tables import Table, read_table
from calib.core.instruments.rotations import Form, not_rotations, rotations_of
from calib.core.robots.robot import Robot
from calib.photographs.images import SUFFIXES

ANGLES = ("rpy", "rotvec")
_POSITION = ("x", "y", "z")
_FORMS: dict[tuple[str, ...], Form] = {
    ("qx", "qy", "qz", "qw"): "quaternion",
    ("q1", "q2", "q3", "q4"): "quaternion",
    ("roll", "pitch", "yaw"): "rpy",
    ("w", "p", "r"): "rpy",
    ("a", "b", "c"): "intrinsic_zyx",
    ("rx", "ry", "rz"): "rotation_vector",
    ("r11", "r12", "r13", "r21", "r22", "r23", "r31", "r32", "r33"): "matrix",
    ("00", "01", "02", "10", "11", "12", "20", "21", "22"): "matrix",
}
_TYPED = 0.01  # allowed error of a rotation's numbers, which are often copied from a pendant with few digits
_LAST_COLUMN = ("03", "13", "23")  # of a 4 x 4 matrix whose cells are named by row and column


def read_tool_poses(
    path: Path | str, *, robot: Robot | None = None, angles: str | None = None
) -> tuple[list[str], FloatArray]:
    """Return the image of each row, and the tool in the base there, (n, 4, 4) [m].

    Args:
        path: A CSV file.
        robot: If given, the file has its joint values, and the tool is the frame of its first target, in its base.
        angles: Meaning of rx, ry, rz, of `ANGLES`.

    Raises:
        DataError: A missing column, a cell that is no number, or an invalid quaternion.
    """
    table = read_table(path, {} if robot is None else robot.description.columns)
    names = image_names(table)
    if robot is not None:
        missing = next((name for name in robot.joint_names if name not in table.names), None)
        if missing is not None:
            raise DataError(table.lacks(missing))
        dimensions = robot.mechanism.dimensions
        joints = np.stack([table.column(name, dimensions[name]) for name in robot.joint_names], axis=1)
        return names, robot.forward(joints)
    places = pose_columns(table)
    if len(places) > 1:
        raise DataError(f"{path}: holds several poses ({', '.join(places)}); keep the tool's alone")
    if places:
        return names, poses_of(table, next(iter(places.values())), angles)
    columns = {name.casefold(): name for name in table.names}
    missing = next((name for name in _POSITION if name not in columns), None)
    if missing is not None:
        raise DataError(
            f"{path}: no column '{missing}'; the pose of the tool needs x, y, z and a rotation"
            f" ({', '.join(map(' '.join, _FORMS))});"
            " joint values need --robot"
        )
    given = ", ".join(table.names)
    raise DataError(f"{path}: no rotation; expected one of: {'; '.join(map(', '.join, _FORMS))}; it has {given}")


@dataclass(frozen=True)
class PoseColumns:
    """Names of the columns of a pose: position, form of the rotation, and rotation."""

    position: tuple[str, ...]
    form: tuple[str, ...]
    rotation: tuple[str, ...]


def pose_columns(table: Table) -> dict[str, PoseColumns]:
    """Return the poses that a table has columns for, by the common beginning of their names.

    A rotation's names begin like its position's, or with R for t (`t_cam_x`, `R_cam_r11`) or rvec for tvec.
    """
    columns = {name.casefold(): name for name in table.names}
    places: dict[str, PoseColumns] = {}
    for name in columns:
        for position in (_POSITION, _LAST_COLUMN):
            start = name.removesuffix(position[0])
            if start == name or not all(start + end in columns for end in position):
                continue
            starts = dict.fromkeys([start, re.sub(r"^t(?=_|$)", "r", start)])
            forms = [(s, form) for s in starts for form in _FORMS if all(s + end in columns for end in form)]
            if start.startswith("tvec") and all(start.replace("tvec", "rvec") + end in columns for end in _POSITION):
                forms.append((start.replace("tvec", "rvec"), _POSITION))
            if forms:
                at, form = forms[0]
                own = columns[start + position[0]].removesuffix(position[0]).removesuffix("_")
                places[own] = PoseColumns(
                    tuple(columns[start + end] for end in position), form, tuple(columns[at + end] for end in form)
                )
    return places


def poses_of(table: Table, place: PoseColumns, angles: str | None = None) -> FloatArray:
    """Return poses of a table, (n, 4, 4) [m]; for `angles` and errors see `read_tool_poses`."""
    poses = np.tile(np.eye(4), (len(table.lines), 1, 1))
    poses[:, :3, 3] = np.stack([table.column(name, "length") for name in place.position], axis=1)
    names, form = place.form, _FORMS.get(place.form, "rotation_vector")  # for rx, ry, rz, tvec and rvec
    if names == ("rx", "ry", "rz"):
        if angles is None:
            raise DataError(
                f"{table.path}: rx, ry, rz may be a rotation vector (Universal Robots) or angles about x, y, z;"
                " say which: --angles rotvec or --angles rpy"
            )
        form = form if angles == "rotvec" else "rpy"
    dimension: Dimension | None = None if form in ("quaternion", "matrix") else "angle"
    numbers = np.stack([table.column(name, dimension) for name in place.rotation], axis=1)
    numbers = np.roll(numbers, -1, axis=1) if names[0] == "q1" else numbers
    bad, what = not_rotations(form, numbers, _TYPED if form == "quaternion" else 2 * _TYPED)
    if len(bad):
        raise DataError(
            f"{table.path}, line {table.lines[bad[0]]}: {names[0]} to {names[-1]} are not {what}; write more digits, or"
            " correct it"
        )
    poses[:, :3, :3] = rotations_of(form, numbers).as_matrix()
    return poses


def image_names(table: Table) -> list[str]:
    """Return the image of each row of a table.

    Raises:
        DataError: No such column, an empty cell, or an image in two rows.
    """
    columns = {name.casefold(): name for name in table.names}
    key = next((columns[name] for name in ("image", "pose", "photo", "file") if name in columns), None)
    if key is None:
        raise DataError(f"{table.path}: no column 'image' or 'pose' that says which photograph each row belongs to")
    names = [Path(cell).stem if cell.lower().endswith(SUFFIXES) else cell for cell in table.text(key)]
    for k, name in enumerate(names):
        if not name:
            raise DataError(f"{table.path}, line {table.lines[k]}, column '{key}': is empty; name the photograph")
        if name in names[:k]:
            raise DataError(f"{table.path}, line {table.lines[k]}, column '{key}': '{name}' comes twice")
    return names


def poses_of_images(
    seen: Sequence[str], path: Path | str, *, robot: Robot | None, angles: str | None
) -> tuple[dict[str, FloatArray], list[str]]:
    """Return the tool at each image that has a row, (4, 4) [m], in the order of the rows, and remarks on the others.

    Raises:
        DataError: No image has a row; or see `read_tool_poses`.
    """
    names, tool = read_tool_poses(path, robot=robot, angles=angles)
    wanted, known = set(seen), set(names)
    remarks = [f"{name}: {path} has no pose of this image{nearest(name, names)}" for name in seen if name not in known]
    if len(remarks) == len(seen):
        raise DataError(
            f"{path}: no row names any of the photographs ({', '.join(list(seen)[:3])}, ...); its rows are called"
            f" {', '.join(names[:3])}, ..."
        )
    return {name: pose for name, pose in zip(names, tool, strict=True) if name in wanted}, remarks
