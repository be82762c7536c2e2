"""Full poses: position and orientation of a sensor frame in the measurement frame.

A six-dimensional tracker sensor, a motion capture system, or a camera that sees a pattern measures them.

Rows are the position error p_ab - p and the rotation error of `calib.core.instruments.rotations`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.instruments.kind import Column, Comparison, FrameInstrument, InstrumentSection, Readings, View
from calib.core.instruments.noise import AngleSigma, Noise, PartNoise, PositionSigma
from calib.core.instruments.position import AXES, POSITION
from calib.core.instruments.rotations import (
    ORIENTATION,
    Form,
    other_rotations,
    read_rotations,
    rotation_columns,
    rotation_errors,
    rotation_matrices,
    rotation_vectors,
    turn_by,
    write_rotations,
)


class PoseSection(InstrumentSection):
    """An instrument that measures the pose of a target frame.

    Attributes:
        target: Name of its target; the instrument's own name if left out.
        rotation: Form of rotations in the file: `quaternion` (columns qx qy qz qw, in any order), `rpy` (roll, pitch,
            yaw about fixed axes, as URDF), `intrinsic_xyz`, `intrinsic_zyx`, `intrinsic_zyz` (angles about moving
            axes), `rotation_vector`, or `matrix` (r11 to r33).
        sigma: Noise of the position: one number, three, or a tracker's `{range, angle}`.
        sigma_angle: Noise of the orientation: one number, or three.
    """

    target: str | None = None
    rotation: Form = "quaternion"
    sigma: PositionSigma | None = None
    sigma_angle: AngleSigma | None = None


@dataclass(frozen=True)
class Pose(FrameInstrument):
    """Poses of one target frame in the measurement frame: six rows. Values are x, y, z and a rotation vector."""

    section = PoseSection
    parts = (POSITION, ORIENTATION)
    rotation: Form = "quaternion"

    @classmethod
    def from_section(cls, name: str, section: PoseSection) -> Pose:
        """Return the instrument that an entry of a robot description means."""
        noise = Noise((PartNoise.from_sigma(section.sigma, 3), PartNoise.from_sigma(section.sigma_angle, 3)))
        return cls(name, section.target or name, section.rotation, noise=noise)

    def columns(self) -> tuple[Column, ...]:
        """Return `<name>_x`, `_y`, `_z`, and those of the rotation."""
        positions = tuple(Column(f"{self.name}_{axis}", "length") for axis in AXES)
        return positions + rotation_columns(self.name, self.rotation)

    def values(self, columns: Mapping[str, FloatArray]) -> FloatArray:
        """Return positions and rotation vectors, (n, 6) [m, rad]."""
        numbers = super().values(columns)
        return np.hstack([numbers[:, :3], read_rotations(self.name, self.rotation, numbers[:, 3:])])

    def cells(self, values: FloatArray) -> dict[str, FloatArray]:
        """Return the columns of positions and rotation vectors, (n, 6) [m, rad]."""
        return super().cells(np.hstack([values[:, :3], write_rotations(self.rotation, values[:, 3:])]))

    def predict(self, view: View, unknowns: FloatArray, details: FloatArray) -> FloatArray:
        """Return p_ab and the rotation vector of R_ab, (n, 6) [m, rad]."""
        return np.hstack([view.translation, rotation_vectors(view.rotation)])

    def compare(self, view: View, unknowns: FloatArray, readings: Readings) -> Comparison:
        """Return position and rotation errors, and their derivatives by dp and dw."""
        n = len(readings)
        turned, by_turn = rotation_errors(view.rotation, readings.values[:, 3:])
        by_twist = np.zeros((n, 6, 6))
        by_twist[:, :3, :3] = np.eye(3)
        by_twist[:, 3:, 3:] = by_turn
        residuals = np.hstack([view.translation - readings.values[:, :3], turned])
        return Comparison(residuals, by_twist, np.zeros((n, 6, 0)))

    def with_errors(self, values: FloatArray, change: FloatArray) -> FloatArray:
        """Return poses with errors of position and orientation."""
        return np.hstack([values[:, :3] + change[:, :3], turn_by(values[:, 3:], change[:, 3:])])

    def points(self, values: FloatArray) -> FloatArray:
        """Return the positions."""
        return values[:, :3]

    def other_meanings(self, values: FloatArray) -> Iterator[tuple[str, FloatArray]]:
        """Yield poses with other readings of their rotations."""
        for words, vectors in other_rotations(self.rotation, values[:, 3:]):
            yield words, np.hstack([values[:, :3], vectors])

    def orientations(self, values: FloatArray) -> FloatArray:
        """Return R_ab, (n, 3, 3)."""
        return rotation_matrices(values[:, 3:])
