"""Rotations in files, and readings that end with a rotation.

Rows of a rotation are the rotation error as a rotation vector in the axes of the measurement frame,

    r = log(R_ab R^T)            d r = J_l(r)^-1 dw,       J_l(r)^-1 = I - [r]x / 2 + c [r]x^2
                                 c = (1 - (|r| / 2) cot(|r| / 2)) / |r|^2

with J_l the left Jacobian of SO(3). r is small where the model fits; it is unique below half a turn.

Reference: sola2018, equation 146.
"""

from __future__ import annotations

from abc import ABC
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.errors import DataError
from calib.core.base.units import Dimension
from calib.core.instruments.kind import Column, Comparison, FrameInstrument, Part, Readings, View
from calib.core.numerics.rigid import cross_matrices

Form = Literal["quaternion", "rpy", "intrinsic_xyz", "intrinsic_zyx", "intrinsic_zyz", "rotation_vector", "matrix"]
ORIENTATION = Part("orientation", ("rx", "ry", "rz"), "angle", largest=0.1)
_COLUMNS: dict[Form, tuple[str, ...]] = {
    "quaternion": ("qx", "qy", "qz", "qw"),
    "rpy": ("roll", "pitch", "yaw"),
    "intrinsic_xyz": ("rx", "ry", "rz"),
    "intrinsic_zyx": ("rz", "ry", "rx"),
    "intrinsic_zyz": ("rz", "ry", "rz2"),
    "rotation_vector": ("rx", "ry", "rz"),
    "matrix": tuple(f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)),
}
_EULER: dict[str, str] = {"rpy": "xyz", "intrinsic_xyz": "XYZ", "intrinsic_zyx": "ZYX", "intrinsic_zyz": "ZYZ"}
_UNIT_LENGTH = 0.05  # allowed deviation of a rounded quaternion from unit length, or of a matrix from a rotation


def rotation_columns(name: str, form: Form) -> tuple[Column, ...]:
    """Return the columns of an instrument's rotations in this form."""
    pure = form in ("quaternion", "matrix")
    dimension: Dimension | None = None if pure else "angle"
    return tuple(Column(f"{name}_{part}", dimension) for part in _COLUMNS[form])


def read_rotations(name: str, form: Form, numbers: FloatArray) -> FloatArray:
    """Return rotation vectors (n, 3) [rad] of numbers (n, k), NaN where missing; `DataError` if not rotations."""
    vectors = np.full((len(numbers), 3), np.nan)
    complete = np.isfinite(numbers).all(axis=1)
    if np.any(complete):
        bad, what = not_rotations(form, numbers[complete])
        if len(bad):
            columns = ", ".join(column.name for column in rotation_columns(name, form))
            reading = int(np.flatnonzero(complete)[bad[0]]) + 1
            raise DataError(
                f"instrument '{name}', reading {reading}: is not {what}; check the columns {columns}, and"
                " `rotation` in the description"
            )
        vectors[complete] = rotations_of(form, numbers[complete]).as_rotvec()
    return vectors


def write_rotations(form: Form, vectors: FloatArray) -> FloatArray:
    """Return rotation vectors (n, 3) [rad] as numbers (n, k) in this form, the inverse of `read_rotations`."""
    rotations = scipy.spatial.transform.Rotation.from_rotvec(vectors.copy())
    if form == "quaternion":
        return np.asarray(rotations.as_quat(canonical=True))
    if form == "matrix":
        return np.asarray(rotations.as_matrix()).reshape(-1, 9)
    if form == "rotation_vector":
        return np.asarray(rotations.as_rotvec())
    return np.asarray(rotations.as_euler(_EULER[form]))


def other_rotations(form: Form, vectors: FloatArray) -> Iterator[tuple[str, FloatArray]]:
    """Yield other meanings of rotation vectors (n, 3) [rad] that were read in this form, in words, and the vectors
    then.
    """
    numbers = write_rotations(form, vectors)
    yield "its rotations were inverse (the frame seen from the sensor)", -vectors
    if form == "quaternion":
        for order, names in (((1, 2, 3, 0), "qw qx qy qz"), ((3, 0, 1, 2), "qy qz qw qx")):
            other = scipy.spatial.transform.Rotation.from_quat(numbers[:, order]).as_rotvec()
            yield f"its columns qx qy qz qw held {names}", other
            yield f"its columns qx qy qz qw held {names}, of inverse rotations", -other
    elif form != "matrix":
        for other_form in (*_EULER, "rotation_vector"):
            if other_form != form:
                other = rotations_of(other_form, numbers).as_rotvec()  # type: ignore[arg-type]
                yield f"its angles were of the form {other_form}", other
        yield "its angles were degrees read as radians", rotations_of(form, np.radians(numbers)).as_rotvec()


def rotation_errors(rotations: FloatArray, vectors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return r of the module docstring (n, 3) [rad] and its derivative by dw (n, 3, 3), from R_ab and R."""
    if len(vectors) == 0:
        return np.zeros((0, 3)), np.zeros((0, 3, 3))
    turned = (
        scipy.spatial.transform.Rotation.from_matrix(rotations.copy())
        * scipy.spatial.transform.Rotation.from_rotvec(vectors.copy()).inv()
    ).as_rotvec()
    return turned, inverse_left_jacobian(turned)


def rotation_vectors(rotations: FloatArray) -> FloatArray:
    """Return rotation matrices (n, 3, 3) as rotation vectors, (n, 3) [rad]."""
    if len(rotations) == 0:
        return np.zeros((0, 3))
    return scipy.spatial.transform.Rotation.from_matrix(rotations.copy()).as_rotvec()


def rotation_matrices(vectors: FloatArray) -> FloatArray:
    """Return rotation vectors (n, 3) [rad] as rotation matrices, (n, 3, 3)."""
    return scipy.spatial.transform.Rotation.from_rotvec(vectors.copy()).as_matrix()


def turn_by(vectors: FloatArray, change: FloatArray) -> FloatArray:
    """Return rotation vectors (n, 3) turned by small errors in the axes of the measurement frame, (n, 3) [rad]."""
    turned = scipy.spatial.transform.Rotation.from_rotvec(change.copy()) * scipy.spatial.transform.Rotation.from_rotvec(
        vectors.copy()
    )
    return turned.as_rotvec()


def rotations_of(form: Form, numbers: FloatArray) -> scipy.spatial.transform.Rotation:
    """Return the rotations of numbers (n, k) in this form."""
    if form == "quaternion":
        return scipy.spatial.transform.Rotation.from_quat(numbers)
    if form == "matrix":
        return scipy.spatial.transform.Rotation.from_matrix(numbers.reshape(-1, 3, 3))
    if form == "rotation_vector":
        return scipy.spatial.transform.Rotation.from_rotvec(numbers)
    return scipy.spatial.transform.Rotation.from_euler(_EULER[form], numbers)


def not_rotations(form: Form, numbers: FloatArray, tolerance: float = _UNIT_LENGTH) -> tuple[IntArray, str]:
    """Return the rows of numbers (n, k) that are no rotation in this form, and the expected thing in words.

    `tolerance` limits the deviation of a quaternion from unit length, and of R R^T of a matrix from the identity.
    """
    if form == "quaternion":
        off, what = np.abs(np.linalg.norm(numbers, axis=1) - 1.0), "a quaternion of length 1"
    elif form == "matrix":
        matrices = numbers.reshape(-1, 3, 3)
        products = matrices @ matrices.transpose(0, 2, 1) - np.eye(3)
        off, what = np.max(np.abs(products), axis=(1, 2)) + (np.linalg.det(matrices) < 0), "a rotation matrix"
    else:
        off, what = np.zeros(len(numbers)), ""
    return np.flatnonzero(off > tolerance), what


def inverse_left_jacobian(vectors: FloatArray) -> FloatArray:
    """Return J_l(r)^-1 of rotation vectors r, (n, 3) [rad] -> (n, 3, 3)."""
    angle = np.linalg.norm(vectors, axis=1)
    half = np.maximum(angle, 1e-8) / 2.0
    factor = np.where(angle > 1e-4, (1.0 - half / np.tan(half)) / (4.0 * half**2), 1.0 / 12.0)
    cross = cross_matrices(vectors)
    return np.eye(3) - cross / 2.0 + factor[:, None, None] * (cross @ cross)


@dataclass(frozen=True)
class RotationInstrument(FrameInstrument, ABC):
    """A kind that reads the orientation of one target frame in the measurement frame, and perhaps its position before.

    Values are x, y, z, if the position is read, and a rotation vector; rows are the errors p_ab - p and r.
    """

    rotation: Form = "quaternion"

    @property
    def _n_lengths(self) -> int:
        """Number of the rows before those of the rotation."""
        return self.n_rows - len(ORIENTATION.axes)

    def columns(self) -> tuple[Column, ...]:
        """Return `<name>_x`, `_y`, `_z`, if the position is read, and those of the rotation."""
        lengths = tuple(Column(f"{self.name}_{axis}", "length") for axis in "xyz"[: self._n_lengths])
        return lengths + rotation_columns(self.name, self.rotation)

    def values(self, columns: Mapping[str, FloatArray]) -> FloatArray:
        """Return values, (n, n_rows) [m, rad]."""
        lengths, numbers = np.split(super().values(columns), [self._n_lengths], axis=1)
        return np.hstack([lengths, read_rotations(self.name, self.rotation, numbers)])

    def cells(self, values: FloatArray) -> dict[str, FloatArray]:
        """Return the columns of values, (n, n_rows) [m, rad]."""
        lengths, vectors = np.split(values, [self._n_lengths], axis=1)
        return super().cells(np.hstack([lengths, write_rotations(self.rotation, vectors)]))

    def predict(self, view: View, unknowns: FloatArray, details: FloatArray) -> FloatArray:
        """Return p_ab, if it is read, and the rotation vector of R_ab, (n, n_rows) [m, rad]."""
        return np.hstack([view.translation[:, : self._n_lengths], rotation_vectors(view.rotation)])

    def compare(self, view: View, unknowns: FloatArray, readings: Readings) -> Comparison:
        """Return errors, and their derivatives by dp and dw."""
        n, first = len(readings), self._n_lengths
        by_twist = np.zeros((n, self.n_rows, 6))
        by_twist[:, :first, :first] = np.eye(first)
        turned, by_twist[:, first:, 3:] = rotation_errors(view.rotation, readings.values[:, first:])
        residuals = np.hstack([view.translation[:, :first] - readings.values[:, :first], turned])
        return Comparison(residuals, by_twist, np.zeros((n, self.n_rows, 0)))

    def with_errors(self, values: FloatArray, change: FloatArray) -> FloatArray:
        """Return values with errors of position and orientation."""
        lengths, vectors = np.split(values, [self._n_lengths], axis=1)
        off, turns = np.split(change, [self._n_lengths], axis=1)
        return np.hstack([lengths + off, turn_by(vectors, turns)])

    def other_meanings(self, values: FloatArray) -> Iterator[tuple[str, FloatArray]]:
        """Yield values with other readings of their rotations."""
        lengths, vectors = np.split(values, [self._n_lengths], axis=1)
        for words, others in other_rotations(self.rotation, vectors):
            yield words, np.hstack([lengths, others])

    def orientations(self, values: FloatArray) -> FloatArray:
        """Return R_ab, (n, 3, 3)."""
        return rotation_matrices(values[:, self._n_lengths :])
