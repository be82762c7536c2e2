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

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import model_validator

from calib.core.base.arrays import FloatArray
from calib.core.base.sections import ANGLE_COMPONENTS
from calib.core.instruments.hand_eye import solve_rotations
from calib.core.instruments.kind import (
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
from calib.core.instruments.rotations import ORIENTATION, Form, RotationInstrument, rotation_matrices
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


Frames = tuple[FloatArray, FloatArray]
"""Orientations of measurement frame and sensor in their links, (3, 3) each."""


@dataclass(frozen=True)
class Orientation(RotationInstrument):
    """Orientations of one target frame: three rows, values are rotation vectors."""

    section = OrientationSection
    parts = (ORIENTATION,)

    @classmethod
    def from_section(cls, name: str, section: OrientationSection) -> Orientation | Inclinometer:
        """Return the instrument that an entry of a robot description means."""
        target = section.target or name
        if section.axes == "gravity":
            return Inclinometer(name, target, noise=Noise((PartNoise.from_sigma(section.sigma, 2),)))
        return cls(name, target, section.rotation, noise=Noise((PartNoise.from_sigma(section.sigma, 3),)))

    def first_values(self, scene: Scene) -> tuple[Guess, ...]:
        """Return the orientations of measurement frame and sensor that fit best, pair by pair."""
        return _first_frames(scene, _solve_seen)


@dataclass(frozen=True)
class Inclinometer(FrameInstrument):
    """Tilts of one target frame against the vertical: two rows."""

    section = OrientationSection
    parts = (TILT,)

    @classmethod
    def from_section(cls, name: str, section: OrientationSection) -> Orientation | Inclinometer:
        """Return the instrument that an entry of a robot description means."""
        return Orientation.from_section(name, section)

    def predict(self, view: View, unknowns: FloatArray, details: FloatArray) -> FloatArray:
        """Return tilts, (n, 2) [rad]."""
        return _tilts(_down(view.rotation))

    def compare(self, view: View, unknowns: FloatArray, readings: Readings) -> Comparison:
        """Return errors of tilt, and their derivatives by dw."""
        down, n = _down(view.rotation), len(readings)
        by_twist = np.zeros((n, 2, 6))
        by_twist[:, :, 3:] = _tilt_derivative(down) @ view.rotation.transpose(0, 2, 1) @ cross_matrices(_DOWN[None])
        return Comparison(_wrap_half_turn(_tilts(down) - readings.values), by_twist, np.zeros((n, 2, 0)))

    def with_errors(self, values: FloatArray, change: FloatArray) -> FloatArray:
        """Return tilts with errors."""
        return _wrap_half_turn(values + change)

    def first_values(self, scene: Scene) -> tuple[Guess, ...]:
        """Return the orientations of measurement frame and sensor that fit best, pair by pair."""
        return _first_frames(scene, _level)


Solver = Callable[[FloatArray, FloatArray, Frames, tuple[bool, bool]], list[Frames]]
"""Frames that fit best, from rotations of links L_i (n, 3, 3), readings (n, n_rows), frames now, and whether known."""


def _first_frames(scene: Scene, solve: Solver) -> tuple[Guess, ...]:
    """Guesses pair by pair; a single one of all places where there are several pairs."""
    used = np.unique(scene.readings.pairs).tolist()
    guesses = [guess for k in used for guess in _guesses_of_pair(scene, k, solve)]
    if len(used) < 2 or not guesses:
        return tuple(guesses)
    together: dict[str, FloatArray] = {}
    for guess in guesses:
        together = {**guess.places, **together}  # the first guess of a place counts
    return (Guess(together),)


def _guesses_of_pair(scene: Scene, number: int, solve: Solver) -> list[Guess]:
    names = scene.pairs[number]
    first, second = (not any(c in ANGLE_COMPONENTS for c in scene.unknown[name]) for name in names)
    chosen = (scene.readings.pairs == number) & np.isfinite(scene.readings.values).all(axis=1)
    if (first and second) or not np.any(chosen):
        return []
    now = (scene.places[names[0]][:3, :3], scene.places[names[1]][:3, :3])
    guesses = []
    for frames in solve(scene.links[chosen][:, :3, :3], scene.readings.values[chosen], now, (first, second)):
        places = {name: scene.places[name].copy() for name in names}
        for name, frame in zip(names, frames, strict=True):
            places[name][:3, :3] = frame
        guesses.append(Guess(places))
    return guesses


def _solve_seen(links: FloatArray, values: FloatArray, now: Frames, known: tuple[bool, bool]) -> list[Frames]:
    fixed = [frame if is_known else None for frame, is_known in zip(now, known, strict=True)]
    return [solve_rotations(links, rotation_matrices(values), *fixed)]


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


def _level(links: FloatArray, values: FloatArray, now: Frames, known: tuple[bool, bool]) -> list[Frames]:
    """Frames C and M for which g_i = M^T L_i^T C (0, 0, -1) fits, from each start of C that is tried."""
    frame, seen = now[0], _directions(values)
    starts = [frame @ _DOWN] if known[0] else [*np.eye(3), *-np.eye(3), frame @ _DOWN]
    solutions = []
    for start in starts:
        down, mounted = start, now[1]
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
