"""Stacks of rotations about one axis, and homogeneous matrices."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def rotation_x(angle: Array) -> Array:
    """Rotations about x, `(n, 3, 3)`, for angles `(n,) [rad]`."""
    return _rotation(angle, 1, 2)


def rotation_y(angle: Array) -> Array:
    """Rotations about y, `(n, 3, 3)`, for angles `(n,) [rad]`."""
    return _rotation(angle, 2, 0)


def rotation_z(angle: Array) -> Array:
    """Rotations about z, `(n, 3, 3)`, for angles `(n,) [rad]`."""
    return _rotation(angle, 0, 1)


def _rotation(angle: Array, first: int, second: int) -> Array:
    """Rotations that take axis `first` towards axis `second`."""
    R = np.tile(np.eye(3), (len(angle), 1, 1))
    R[:, first, first] = R[:, second, second] = np.cos(angle)
    R[:, second, first] = np.sin(angle)
    R[:, first, second] = -np.sin(angle)
    return R


def homogeneous(R: Array, p: Array) -> Array:
    """Matrices `(n, 4, 4)` from rotations `(n, 3, 3)` and points `(n, 3)`."""
    T = np.zeros((len(p), 4, 4))
    T[:, :3, :3] = R
    T[:, :3, 3] = p
    T[:, 3, 3] = 1.0
    return T
