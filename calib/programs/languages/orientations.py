"""Orientations as the languages of controllers write them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Literal

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import DataError

_UNIT_LENGTH = 1e-3  # allowed deviation of a quaternion from unit length
Rotation = Literal["vector", "quaternion", "zyx", "xyz"]
"""How a language writes an orientation: rotation vector; quaternion w, x, y, z; angles about z, y', x'' (A, B, C of
KUKA); the same rotation as angles x, y, z about fixed axes (W, P, R of FANUC)."""


def pose_of(values: Sequence[float], rotation: Rotation, where: str = "") -> pin.SE3:
    """Return the pose of a position [m] and an orientation in a language's form [rad or quaternion].

    Raises:
        DataError: The quaternion does not have unit length.
    """
    turned = np.array(values[3:])
    if rotation == "quaternion" and abs(np.linalg.norm(turned) - 1) > _UNIT_LENGTH:
        raise DataError(f"{where}: the quaternion has length {np.linalg.norm(turned):.6g}, not 1; correct it")
    return pin.SE3(_ROTATIONS[rotation][0](turned), np.array(values[:3]))


def numbers_of(pose: pin.SE3, rotation: Rotation, near: Sequence[float]) -> tuple[float, ...]:
    """Return the numbers of a pose [m, rad], among equal orientations those nearest to the numbers `near`."""
    turned = _ROTATIONS[rotation][1](pose.rotation, np.array(near[3:]))
    return (*map(float, pose.translation), *map(float, turned))


def _to_vector(R: FloatArray, near: FloatArray) -> FloatArray:
    """The rotation vector nearest to `near`, (3,), among those of the same rotation."""
    v = np.asarray(pin.log3(R))
    angle = float(np.linalg.norm(v))
    if angle < 1e-9:
        return v
    return _nearest((v * (1 + 2 * np.pi * k / angle) for k in (-1, 0, 1)), near)


def _to_quaternion(R: FloatArray, near: FloatArray) -> FloatArray:
    x, y, z, w = pin.Quaternion(R).normalized().coeffs()
    return _nearest((np.array([w, x, y, z]), -np.array([w, x, y, z])), near)


def _to_xyz(R: FloatArray, near: FloatArray) -> FloatArray:
    """Roll, pitch and yaw nearest to `near`, (3,), among both triples of the same rotation."""
    angles = np.asarray(pin.rpy.matrixToRpy(R))
    other = np.array([angles[0] + np.pi, np.pi - angles[1], angles[2] + np.pi])
    best = _nearest((v + 2 * np.pi * np.round((near - v) / (2 * np.pi)) for v in (angles, other)), near)
    return np.where(np.abs(best) > np.pi, best - np.sign(best) * 2 * np.pi, best)


def _nearest(vectors: Iterable[FloatArray], near: FloatArray) -> FloatArray:
    return min(vectors, key=lambda vector: float(np.linalg.norm(vector - near)))


_ROTATIONS: dict[
    Rotation, tuple[Callable[[FloatArray], FloatArray], Callable[[FloatArray, FloatArray], FloatArray]]
] = {
    "vector": (pin.exp3, _to_vector),
    "quaternion": (lambda q: pin.Quaternion(*(q / np.linalg.norm(q))).toRotationMatrix(), _to_quaternion),
    "zyx": (lambda v: pin.rpy.rpyToMatrix(*v[::-1]), lambda R, near: _to_xyz(R, near[::-1])[::-1]),
    "xyz": (lambda v: pin.rpy.rpyToMatrix(*v), _to_xyz),
}
