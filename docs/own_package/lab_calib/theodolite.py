"""A theodolite: azimuth and elevation of a target, from a levelled station whose place and heading must be found.

    azimuth = atan2(y, x)        elevation = atan2(z, sqrt(x^2 + y^2))        (x, y, z) = p_ab

Frame a is the station, its z axis up; frame b is the target. When it fails: a target straight above the
station has no azimuth. Angles show no scale: it comes from the lengths of the robot.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calib.extend import (
    Column,
    Comparison,
    ComputationError,
    DataError,
    FrameInstrument,
    FrameSection,
    Guess,
    InstrumentSection,
    Noise,
    Part,
    PartNoise,
    Place,
    PositiveAngle,
    PositiveLength,
    Readings,
    Scene,
    View,
)


class TheodoliteSection(InstrumentSection):
    """Its target, about where it stands, how far off that may be [m], and its noise [rad]."""

    target: str
    station: FrameSection
    sigma_station: PositiveLength
    sigma: PositiveAngle | None = None


@dataclass(frozen=True)
class Theodolite(FrameInstrument):
    """Directions to one target from a station: two rows."""

    section = TheodoliteSection
    parts = (Part("direction", ("azimuth", "elevation"), "angle", usual=1e-4),)
    station: Place

    @classmethod
    def from_section(cls, name: str, section: TheodoliteSection) -> "Theodolite":
        """Return the instrument that an entry of a robot description means."""
        at, open_ = section.station, ("x", "y", "z", "rz")
        station = Place(f"{name}_station", at.frame, at.xyz, at.rpy, open_, section.sigma_station)
        return cls(name, section.target, station, noise=Noise((PartNoise.from_sigma(section.sigma, 2),)))

    def places(self) -> tuple[Place, ...]:
        """Return the station."""
        return (self.station,)

    def pairs(self, base: str) -> tuple[tuple[str, str], ...]:
        """Return station and target."""
        return ((self.station.name, self.target),)

    def columns(self) -> tuple[Column, ...]:
        """Return `<name>_azimuth` and `<name>_elevation`."""
        return tuple(Column(f"{self.name}_{axis}", "angle") for axis in self.parts[0].axes)

    def values(self, columns: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the angles, (n, 2) [rad]; refuse an elevation beyond 90 degrees."""
        angles = super().values(columns)
        beyond = np.flatnonzero(np.abs(angles[:, 1]) > np.pi / 2)
        if len(beyond):
            degrees = np.degrees(angles[beyond[0], 1])
            raise DataError(
                f"instrument '{self.name}', reading {beyond[0] + 1}: elevation of {degrees:.4g} deg is impossible"
            )
        return angles

    def predict(self, view: View, unknowns: np.ndarray, details: np.ndarray) -> np.ndarray:
        """Return azimuth and elevation, (n, 2) [rad]."""
        x, y, z = view.translation.T
        return np.column_stack([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))])

    def compare(self, view: View, unknowns: np.ndarray, readings: Readings) -> Comparison:
        """Return errors of the angles, and how dp moves them."""
        x, y, z = view.translation.T
        level, far = np.hypot(x, y), np.linalg.norm(view.translation, axis=1)
        if np.any(level < 1e-6):
            raise ComputationError(f"instrument '{self.name}': its target is straight above it; place it elsewhere")
        by_twist, none = np.zeros((len(readings), 2, 6)), np.zeros((len(readings), 2, 0))
        by_twist[:, 0, :2] = np.column_stack([-y, x]) / level[:, None] ** 2
        by_twist[:, 1, :3] = np.column_stack([-x * z / level, -y * z / level, level]) / far[:, None] ** 2
        off = self.predict(view, unknowns, readings.details) - readings.values
        return Comparison(np.mod(off + np.pi, 2 * np.pi) - np.pi, by_twist, none)

    def first_values(self, scene: Scene) -> tuple[Guess, ...]:
        """Return the heading that fits best where the station is said to be; fitting finds the rest."""
        station = scene.places[scene.pairs[0][0]].copy()
        seen = np.linalg.inv(station) @ scene.links @ scene.places[scene.pairs[0][1]]
        turn = np.nanmean(np.exp(1j * (np.arctan2(seen[:, 1, 3], seen[:, 0, 3]) - scene.readings.values[:, 0])))
        station[:3, :2] = station[:3, :2] @ [[turn.real, -turn.imag], [turn.imag, turn.real]] / abs(turn)
        return (Guess({scene.pairs[0][0]: station}),)
