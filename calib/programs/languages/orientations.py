"""Orientations as the languages of controllers write them, and tables of tools and frames."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import DataError
from calib.core.data.tables import read_table

_UNIT_LENGTH = 1e-3  # by how much a quaternion may miss it
Rotation = Literal["vector", "quaternion", "zyx", "xyz"]
"""How a language writes an orientation: rotation vector; quaternion w, x, y, z; angles about z, y', x'' (A, B, C of
KUKA); the same angles as x, y, z about fixed axes (W, P, R of FANUC)."""


def pose_of(values: Sequence[float], rotation: Rotation, where: str = "") -> pin.SE3:
    """Return a pose from its numbers: a position [m] and an orientation as a language writes it [rad].

    Raises:
        DataError: A quaternion that is none.
    """
    turned = np.array(values[3:])
    if rotation == "quaternion" and abs(np.linalg.norm(turned) - 1) > _UNIT_LENGTH:
        raise DataError(f"{where}: the quaternion has length {np.linalg.norm(turned):.6g}, not 1; correct it")
    return pin.SE3(_ROTATIONS[rotation][0](turned), np.array(values[:3]))


def numbers_of(pose: pin.SE3, rotation: Rotation, near: Sequence[float]) -> tuple[float, ...]:
    """Return the numbers of a pose [m, rad], of those that are the same turn the ones nearest to given ones."""
    turned = _ROTATIONS[rotation][1](pose.rotation, np.array(near[3:]))
    return (*map(float, pose.translation), *map(float, turned))


def _from_vector(v: FloatArray) -> FloatArray:
    return np.asarray(pin.exp3(v))


def _to_vector(R: FloatArray, near: FloatArray) -> FloatArray:
    """Rotation vector, of those that are the same turn the one nearest to the given."""
    v = np.asarray(pin.log3(R))
    angle = float(np.linalg.norm(v))
    if angle < 1e-9:
        return v
    return min(
        (v * (1 + 2 * np.pi * k / angle) for k in (-1, 0, 1)), key=lambda vector: float(np.linalg.norm(vector - near))
    )


def _from_quaternion(q: FloatArray) -> FloatArray:
    w, x, y, z = q / np.linalg.norm(q)
    return np.asarray(pin.Quaternion(w, x, y, z).toRotationMatrix())


def _to_quaternion(R: FloatArray, near: FloatArray) -> FloatArray:
    x, y, z, w = pin.Quaternion(R).normalized().coeffs()
    q = np.array([w, x, y, z])
    return q if q @ near >= 0 else -q


def _from_xyz(angles: FloatArray) -> FloatArray:
    return np.asarray(pin.rpy.rpyToMatrix(*angles))


def _to_xyz(R: FloatArray, near: FloatArray) -> FloatArray:
    """Roll, pitch and yaw, of the two that are the same turn the one nearest to the given."""
    angles = np.asarray(pin.rpy.matrixToRpy(R))
    other = np.array([angles[0] + np.pi, np.pi - angles[1], angles[2] + np.pi])
    both = [triple + 2 * np.pi * np.round((near - triple) / (2 * np.pi)) for triple in (angles, other)]
    best = min(both, key=lambda triple: float(np.linalg.norm(triple - near)))
    return np.where(np.abs(best) > np.pi, best - np.sign(best) * 2 * np.pi, best)


_ROTATIONS: dict[
    Rotation, tuple[Callable[[FloatArray], FloatArray], Callable[[FloatArray, FloatArray], FloatArray]]
] = {
    "vector": (_from_vector, _to_vector),
    "quaternion": (_from_quaternion, _to_quaternion),
    "zyx": (lambda v: _from_xyz(v[::-1]), lambda R, near: _to_xyz(R, near[::-1])[::-1]),
    "xyz": (_from_xyz, _to_xyz),
}


def read_frames(path: Path | str) -> dict[str, pin.SE3]:
    """Read tools and frames that a program names and does not declare.

    Columns: `name`; x, y, z [m]; rx, ry, rz [rad], about fixed axes. The pose of a tool is seen from the flange, of a
    frame from the robot's base.

    Raises:
        DataError: The message names file, line and column.
    """
    table = read_table(path)
    if "name" not in table.names:
        raise DataError(f"{path}: no column 'name'; it says what the program calls each tool and frame")
    names = [name.upper().replace(" ", "") for name in table.text("name")]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise DataError(f"{path}: '{twice}' is given twice; give each tool and frame once")
    columns = [table.column(name, "length") for name in "xyz"]
    columns += [table.column(name, "angle") for name in ("rx", "ry", "rz")]
    return {name: pose_of(row, "xyz") for name, *row in zip(names, *columns, strict=True)}
