"""A laser line on a two-dimensional sensor: where a fixed beam meets a sensor chip on the robot.

    spot = (x_b . (c - p), y_b . (c - p)),    c = (0, 0, z_b . p / z_b_z)

Frame a is the beam, along its z axis; frame b is the chip: its axes x_b, y_b, z_b and its middle p. When it fails: a
beam shows no shift along itself; have two that cross.
"""

from dataclasses import dataclass

import numpy as np

from calib.extend import (
    FrameSection,
    InstrumentSection,
    Noise,
    Part,
    PartNoise,
    Place,
    PositiveLength,
    Readings,
    Relation,
    View,
)

FLATTEST = 0.5  # cosine of the angle between beam and normal beyond which a chip reads nothing


class LaserLineSection(InstrumentSection):
    """The chip; the beam, about, and how far off it may be [m], [rad]; where along it the chip is held; half a chip."""

    target: str
    beam: FrameSection
    sigma_beam: PositiveLength
    reach: tuple[PositiveLength, PositiveLength]
    half: PositiveLength = 0.01
    sigma: PositiveLength | None = None


@dataclass(frozen=True)
class LaserLine(Relation):
    """Coordinates of the spot in the axes of the chip: two rows."""

    section = LaserLineSection
    parts = (Part("spot", ("u", "v"), "length", usual=1e-5),)
    may_see_nothing = True
    reach: tuple[float, float] = (0.0, 1.0)
    half: float = 0.01

    @classmethod
    def from_section(cls, name: str, section: LaserLineSection) -> "LaserLine":
        """Return the instrument that an entry of a robot description means."""
        at, sigma = section.beam, section.sigma_beam
        beam = Place(f"{name}_beam", at.frame, at.xyz, at.rpy, ("x", "y", "rx", "ry"), sigma, sigma / section.reach[0])
        noise = Noise((PartNoise.from_sigma(section.sigma, 2),))
        return cls(name, section.target, (beam,), section.reach, section.half, noise=noise)

    def spots(self, view: View) -> np.ndarray:
        """Return where the line meets the plane of the chip, (n, 2) [m]."""
        normal = view.rotation[:, :, 2]
        along = np.sum(normal * view.translation, axis=1) / normal[:, 2]
        return np.einsum("nij,ni->nj", view.rotation[:, :, :2], [0.0, 0.0, 1.0] * along[:, None] - view.translation)

    def predict(self, view: View, unknowns: np.ndarray, details: np.ndarray) -> np.ndarray:
        """Return the spot, (n, 2) [m]; NaN beside the chip, and on its back."""
        spot = self.spots(view)
        seen = (np.abs(spot).max(axis=1) < self.half) & (view.rotation[:, 2, 2] < -FLATTEST)
        return np.where(seen[:, None], spot, np.nan)

    def misses(self, view: View, unknowns: np.ndarray, readings: Readings) -> np.ndarray:
        """Return predicted minus read, (n, 2) [m], also where the present robot would miss the chip."""
        return self.spots(view) - readings.values

    def sights(self, count: int, generator: np.random.Generator) -> View:
        """Return chips on the beam that face it."""
        z = generator.uniform(-0.4, 0.4, (count, 3)) - [0.0, 0.0, 1.0]
        y = np.cross(z, generator.standard_normal((count, 3)))
        axes = np.stack([np.cross(y, z), y, z], axis=2)
        at = generator.uniform([0.0, 0.0, self.reach[0]], [0.0, 0.0, self.reach[1]], (count, 3))
        return View(axes / np.linalg.norm(axes, axis=1, keepdims=True), at)
