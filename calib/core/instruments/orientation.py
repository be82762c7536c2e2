"""Orientations: the rotation of a sensor frame in the measurement frame, or the tilts of an inclinometer on it.

`axes: all`. Three rows, the rotation error of `calib.core.instruments.rotations`.

`axes: gravity`. The z axis of the measurement frame points up. The sensor sees where down is,

    g = R_ab^T (0, 0, -1)            tilt_x = atan2(-g_y, -g_z),      tilt_y = atan2(g_x, -g_z)

Both are 0 where the sensor is level, and grow as it turns by the right hand about its own x, or y, axis from there:
the tilts of a dual-axis inclinometer in the planes y-z and x-z of its housing. With dg = R_ab^T [(0, 0, -1)]x dw

    d tilt_x = (g_z dg_y - g_y dg_z) / (g_y^2 + g_z^2)            d tilt_y = (g_x dg_z - g_z dg_x) / (g_x^2 + g_z^2)

When it fails. A turn of the measurement frame about its z axis is not seen. If the x or y axis of the sensor is nearly
vertical, the tilt about this axis may take any value.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import model_validator

from calib.core.base.arrays import FloatArray
from calib.core.base.sections import ANGLE_COMPONENTS
from calib.core.instruments.hand_eye import solve_rotations
from calib.core.instruments.kind import (
    Column,
    Comparison,
    FrameInstrument,
    Guess,
    InstrumentSection,
    Part,
    Readings,
    Scene,
    View,
)
from calib.core.instruments.noise import AngleSigma, Noise, PartNoise
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
from calib.core.numerics.rigid import cross_matrices, nearest_rotation

TILT = Part("tilt", ("tilt_x", "tilt_y"), "angle", largest=0.1)
_DOWN = np.array([0.0, 0.0, -1.0])
_SMALLEST = 1e-12  # smallest squared length of g in the plane of a tilt
_ROUNDS = 100
_SETTLED = 1e-10


class OrientationSection(InstrumentSection):
    """An instrument that measures how a target frame is turned.

    Attributes:
        target: Name of its target; the instrument's own name if left out.
        axes: `all`: its rotation in the measurement frame; `gravity`: two tilts against the vertical.
        rotation: Form of rotations in the file; see `calib.core.instruments.pose`.
        sigma: Noise: one number, or one for each of three axes.
    """

    target: str | None = None
    axes: Literal["all", "gravity"] = "all"
    rotation: Form = "quaternion"
    sigma: AngleSigma | None = None

    @model_validator(mode="after")
    def _fits_axes(self) -> OrientationSection:
        if self.axes == "gravity" and isinstance(self.sigma, tuple):
            raise ValueError("sigma: an inclinometer has two tilts; give one number for both")
        if self.axes == "gravity" and "rotation" in self.model_fields_set:
            raise ValueError("rotation: an inclinometer writes two tilts and no rotations; leave it out")
        return self


@dataclass(frozen=True)
class Orientation(FrameInstrument):
    """Orientations of one target frame: three rows, values are rotation vectors; or two tilts."""

    section = OrientationSection
    gravity: bool = False
    rotation: Form = "quaternion"

    @classmethod
    def from_section(cls, name: str, section: OrientationSection) -> Orientation:
        """Return the instrument that an entry of a robot description means."""
        gravity = section.axes == "gravity"
        noise = Noise((PartNoise.from_sigma(section.sigma, 2 if gravity else 3),))
        return cls(name, section.target or name, gravity, section.rotation, noise=noise)

    @property
    def parts(self) -> tuple[Part, ...]:
        """Rotation errors, or tilts."""
        return (TILT,) if self.gravity else (ORIENTATION,)

    def columns(self) -> tuple[Column, ...]:
        """Return the columns of the rotation, or `<name>_tilt_x` and `<name>_tilt_y`."""
        return super().columns() if self.gravity else rotation_columns(self.name, self.rotation)

    def values(self, columns: Mapping[str, FloatArray]) -> FloatArray:
        """Return rotation vectors (n, 3), or tilts (n, 2) [rad]."""
        numbers = super().values(columns)
        return numbers if self.gravity else read_rotations(self.name, self.rotation, numbers)

    def cells(self, values: FloatArray) -> dict[str, FloatArray]:
        """Return the columns of rotation vectors (n, 3), or of tilts (n, 2) [rad]."""
        return super().cells(values if self.gravity else write_rotations(self.rotation, values))

    def predict(self, view: View, unknowns: FloatArray, details: FloatArray) -> FloatArray:
        """Return the rotation vector of R_ab, (n, 3), or tilts, (n, 2) [rad]."""
        return _tilts(_down(view.rotation)) if self.gravity else rotation_vectors(view.rotation)

    def compare(self, view: View, unknowns: FloatArray, readings: Readings) -> Comparison:
        """Return errors of orientation or tilt, and their derivatives by dw."""
        if self.gravity:
            down = _down(view.rotation)
            residuals = _wrap_half_turn(_tilts(down) - readings.values)
            by_turn: FloatArray = (
                _tilt_derivative(down) @ view.rotation.transpose(0, 2, 1) @ cross_matrices(_DOWN[None])
            )
        else:
            residuals, by_turn = rotation_errors(view.rotation, readings.values)
        by_twist = np.zeros((len(readings), self.n_rows, 6))
        by_twist[:, :, 3:] = by_turn
        return Comparison(residuals, by_twist, np.zeros((len(readings), self.n_rows, 0)))

    def with_errors(self, values: FloatArray, change: FloatArray) -> FloatArray:
        """Return orientations or tilts with errors."""
        return _wrap_half_turn(values + change) if self.gravity else turn_by(values, change)

    def other_meanings(self, values: FloatArray) -> Iterator[tuple[str, FloatArray]]:
        """Yield other readings of the rotations."""
        if not self.gravity:
            yield from other_rotations(self.rotation, values)

    def orientations(self, values: FloatArray) -> FloatArray | None:
        """Return R_ab, (n, 3, 3); None for an inclinometer."""
        return None if self.gravity else rotation_matrices(values)

    def first_values(self, scene: Scene) -> tuple[Guess, ...]:
        """Return the orientations of measurement frame and sensor that fit best, pair by pair."""
        pairs = range(len(scene.pairs))
        used = [k for k in pairs if np.any(scene.readings.pairs == k)]
        guesses = [guess for k in used for guess in self._guess_of_pair(scene, k)]
        if len(used) < 2 or not guesses:
            return tuple(guesses)
        together: dict[str, FloatArray] = {}
        for guess in guesses:
            together = {**guess.places, **together}  # the first guess of a place counts
        return (Guess(together),)

    def _guess_of_pair(self, scene: Scene, number: int) -> tuple[Guess, ...]:
        names = scene.pairs[number]
        known = [not any(c in ANGLE_COMPONENTS for c in scene.unknown[name]) for name in names]
        chosen = (scene.readings.pairs == number) & np.isfinite(scene.readings.values).all(axis=1)
        if all(known) or not np.any(chosen):
            return ()
        first, second = (scene.places[name].copy() for name in names)
        links, values = scene.links[chosen][:, :3, :3], scene.readings.values[chosen]
        if not self.gravity:
            first[:3, :3], second[:3, :3] = solve_rotations(
                links,
                rotation_matrices(values),
                first[:3, :3] if known[0] else None,
                second[:3, :3] if known[1] else None,
            )
            return (Guess({names[0]: first, names[1]: second}),)
        guesses = []
        for frame, sensor in _level(links, _directions(values), first[:3, :3], second[:3, :3], known):
            first_guess, second_guess = first.copy(), second.copy()
            first_guess[:3, :3], second_guess[:3, :3] = frame, sensor
            guesses.append(Guess({names[0]: first_guess, names[1]: second_guess}))
        return tuple(guesses)


def _down(rotation: FloatArray) -> FloatArray:
    """Direction of down in sensor frames R_ab, (n, 3, 3) -> (n, 3)."""
    return -rotation[:, 2, :]


def _tilts(down: FloatArray) -> FloatArray:
    return np.stack([np.arctan2(-down[:, 1], -down[:, 2]), np.arctan2(down[:, 0], -down[:, 2])], axis=1)


def _tilt_derivative(down: FloatArray) -> FloatArray:
    """Derivative of the tilts by g, (n, 2, 3)."""
    x, y, z = down.T
    across, along = np.maximum(y**2 + z**2, _SMALLEST), np.maximum(x**2 + z**2, _SMALLEST)
    result = np.zeros((len(down), 2, 3))
    result[:, 0, 1], result[:, 0, 2] = z / across, -y / across
    result[:, 1, 0], result[:, 1, 2] = -z / along, x / along
    return result


def _directions(tilts: FloatArray) -> FloatArray:
    """Direction of down in the sensor frame, from its tilts, (n, 2) -> (n, 3)."""
    upright = np.where(np.cos(tilts[:, 0]) + np.cos(tilts[:, 1]) < 0, -1.0, 1.0)
    bounded = np.clip(np.tan(tilts), -1e6, 1e6)
    down = upright[:, None] * np.stack([bounded[:, 1], -bounded[:, 0], -np.ones(len(tilts))], axis=1)
    return down / np.linalg.norm(down, axis=1)[:, None]


def _wrap_half_turn(angles: FloatArray) -> FloatArray:
    return np.mod(angles + np.pi, 2 * np.pi) - np.pi


def _level(
    links: FloatArray, seen: FloatArray, frame: FloatArray, sensor: FloatArray, known: list[bool]
) -> list[tuple[FloatArray, FloatArray]]:
    """Orientations of measurement frame and sensor in their links for which g_i = M^T L_i^T C (0, 0, -1) fits.

    From L_i (n, 3, 3), g_i (n, 3), the present C and M (3, 3), and whether each of them is known.
    """
    starts = [frame @ _DOWN] if known[0] else [*np.eye(3), *-np.eye(3), frame @ _DOWN]
    solutions = []
    for start in starts:
        down, mounted = start, sensor
        for _ in range(1 if known[0] else _ROUNDS):
            if not known[1]:
                mounted = nearest_rotation(np.einsum("kba,b,kc->ac", links, down, seen))
            last: FloatArray = down
            if not known[0]:
                mean = np.einsum("kab,bc,kc->a", links, mounted, seen)
                down = mean / max(float(np.linalg.norm(mean)), 1e-12)
            if np.max(np.abs(down - last)) < _SETTLED:
                break
        solutions.append((_turn_towards(frame, down), mounted))
    return solutions


def _turn_towards(frame: FloatArray, down: FloatArray) -> FloatArray:
    """Turn a frame by the smallest angle so that its own down points along a direction, (3, 3)."""
    now = frame @ _DOWN
    axis, cosine = np.cross(now, down), float(now @ down)
    if cosine < -1.0 + 1e-12:
        return frame @ np.diag([1.0, -1.0, -1.0])
    cross = cross_matrices(axis[None])[0]
    return (np.eye(3) + cross + cross @ cross / (1.0 + cosine)) @ frame
