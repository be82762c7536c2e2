"""Full poses: position and orientation of a sensor frame in the measurement frame.

A six-dimensional tracker sensor, a motion capture system, or a camera that sees a pattern measures them.

Rows are the position error p_ab - p and the rotation error of `calib.core.instruments.rotations`.
"""

from __future__ import annotations

from dataclasses import dataclass

from calib.core.base.arrays import FloatArray
from calib.core.instruments.kind import InstrumentSection
from calib.core.instruments.noise import AngleSigma, Noise, PartNoise, PositionSigma
from calib.core.instruments.position import POSITION
from calib.core.instruments.rotations import ORIENTATION, Form, RotationInstrument


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
class Pose(RotationInstrument):
    """Poses of one target frame in the measurement frame: six rows. Values are x, y, z and a rotation vector."""

    section = PoseSection
    parts = (POSITION, ORIENTATION)

    @classmethod
    def from_section(cls, name: str, section: PoseSection) -> Pose:
        """Return the instrument that an entry of a robot description means."""
        noise = Noise((PartNoise.from_sigma(section.sigma, 3), PartNoise.from_sigma(section.sigma_angle, 3)))
        return cls(name, section.target or name, section.rotation, noise=noise)

    def points(self, values: FloatArray) -> FloatArray:
        """Return the positions."""
        return values[:, :3]
