"""Touches: the robot brings its target, a ball's centre or a probe's tip, to something fixed; only joints are read.

With p = p_ab, the target seen from the touched thing, point c of an artefact (0 without one), its error e where a
tolerance is stated, and radii r of the ball and R of the sphere:

    socket   p - c - e                     three rows
    plane    p_z - r                       one row; the ball is on the side where z > 0
    sphere   |p - c - e| - (R + r)         one row

When it fails. If the link of the ball hardly turns, readings cannot tell its place from those of the sockets: first
values keep the ball near its described place. A turn about the line of all points of an artefact moves none of them and
is not free.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
import pinocchio as pin
from pydantic import Field, model_validator

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.parameter import Parameter
from calib.core.base.sections import (
    ANGLE_COMPONENTS,
    LENGTH_COMPONENTS,
    Component,
    Length,
    LengthOrUnknown,
    OwnLength,
    PlaceSection,
    PosedSection,
    PositiveLength,
)
from calib.core.instruments.distance import distances
from calib.core.instruments.kind import Comparison, InstrumentSection, Part, Place, Readings, View, placed
from calib.core.instruments.noise import Noise, PartNoise
from calib.core.instruments.relation import Relation
from calib.core.numerics import linalg

Surface = Literal["socket", "plane", "sphere"]
_ON_A_LINE = 1e-6  # points whose width is less are on one line [m]


class TouchedSection(PlaceSection):
    """A socket, plane or sphere that is touched; a plane has a position along its normal, and the normal's orientation.

    Attributes:
        xyz: Socket or centre of a sphere, or a point of a plane, in its link [m].
        rpy: Rotation whose z axis is the normal of a plane, on the side of the ball [rad].
        radius: Radius of a sphere: a length; `{value, sigma}`; or `unknown`.
    """

    what = "place"
    radius: LengthOrUnknown | None = None

    def place(self, name: str, surface: Surface) -> Place:
        """Return the described socket, plane or sphere as a place."""
        unknown: tuple[Component, ...] = ()
        if self.position == "unknown":
            unknown = LENGTH_COMPONENTS if surface != "plane" else (self.normal_component(),)
        if self.orientation == "unknown":
            unknown += ("rx", "ry")
        return placed(name, self, unknown)

    def normal_component(self) -> Component:
        """Return the axis of the link nearest to the normal of a plane; the fit moves an unknown plane along it."""
        normal = np.round(pin.rpy.rpyToMatrix(*self.rpy)[:, 2], 9)  # of two that are as near, the first
        return LENGTH_COMPONENTS[int(np.argmax(np.abs(normal)))]


class ArtefactSection(PosedSection):
    """Several sockets or spheres whose places to each other are known: a plate, a bar.

    Attributes:
        pose: `known`, or `unknown`: found from the measurements, as far as its points determine it.
        points: Each socket, or centre of a sphere, in the artefact [m].
        tolerance: Standard deviation of each coordinate of the points [m]; if given, the points are found.
        radius: Radius of its spheres, all alike: a length; `{value, sigma}`; or `unknown`.
    """

    what = "an artefact"
    points: dict[str, tuple[Length, Length, Length]] = Field(min_length=1)
    tolerance: PositiveLength | None = None
    radius: LengthOrUnknown | None = None

    @model_validator(mode="after")
    def _makes_sense(self) -> ArtefactSection:
        names: dict[tuple[float, ...], str] = {}
        for name, point in self.points.items():
            if names.setdefault(point, name) != name:
                raise ValueError(f"the points '{names[point]}' and '{name}' are at the same place")
        return self

    def place(self, name: str) -> Place:
        """Return the artefact as a place; a turn that moves none of its points is not free."""
        return placed(name, self, LENGTH_COMPONENTS + self._turns() if self.pose == "unknown" else ())

    def _turns(self) -> tuple[Component, ...]:
        """Turns that the points determine: all; all but one for points on a line; none for a single point."""
        points = np.array(list(self.points.values()))
        _, sizes, directions = linalg.svd(points - points.mean(axis=0))
        width = np.append(sizes, [0.0, 0.0])
        if width[0] <= _ON_A_LINE:
            return ()
        if width[1] > _ON_A_LINE:
            return ANGLE_COMPONENTS
        fixed = int(np.argmax(np.abs(directions[0])))
        return tuple(turn for k, turn in enumerate(ANGLE_COMPONENTS) if k != fixed)


class TouchSection(InstrumentSection):
    """An instrument that is the robot itself: its target touches something.

    Attributes:
        target: The centre of the ball, or the tip, that touches; the instrument's own name if left out.
        surface: Kind of the touched surface: `socket`, which holds the centre of the ball in one point; `plane`;
            `sphere`.
        radius: Radius of the ball, for planes and spheres [m].
        places: The touched places, by name.
        artefact: The touched piece, in place of `places`.
        sigma: Noise of a touch: of each coordinate in a socket, of the gap to a plane or sphere [m].
    """

    target: str | None = None
    surface: Surface = "socket"
    radius: Annotated[Length, Field(ge=0)] = 0.0
    places: dict[str, TouchedSection] = Field(default={})
    artefact: ArtefactSection | None = None
    sigma: PositiveLength | None = None

    @model_validator(mode="after")
    def _makes_sense(self) -> TouchSection:
        if bool(self.places) == (self.artefact is not None):
            raise ValueError("give what is touched: either `places` or an `artefact`")
        if self.surface == "plane" and self.artefact is not None:
            raise ValueError("an artefact has sockets or spheres; give planes as `places`")
        if self.surface == "socket" and self.radius:
            raise ValueError("radius is for planes and spheres; a socket holds the centre of the ball")
        for where, touched in ((f"places.{name}: ", place) for name, place in self.places.items()):
            if self.surface != "plane" and (any(touched.rpy) or touched.orientation == "unknown"):
                raise ValueError(f"{where}rpy and orientation are for planes; a {self.surface} has a position only")
            self._check_radius(where, touched.radius)
        if self.artefact is not None:
            self._check_radius("artefact: ", self.artefact.radius)
        return self

    def _check_radius(self, where: str, radius: OwnLength | None) -> None:
        if self.surface == "sphere" and radius is None:
            raise ValueError(f"{where}a sphere needs its radius, or 'radius: unknown'")
        if self.surface != "sphere" and radius is not None:
            raise ValueError(f"{where}radius is for spheres")
        if radius is not None and radius.value <= 0 and (not radius.unknown or radius.sigma is not None):
            raise ValueError(f"{where}radius must be positive")


_PARTS: dict[Surface, Part] = {
    "socket": Part("contact", LENGTH_COMPONENTS, "length", plural="points of contact"),
    "plane": Part("gap", ("gap",), "length", plural="distances from the touched surface"),
    "sphere": Part("gap", ("gap",), "length", plural="distances from the touched surface"),
}
_RADIUS = 0.01  # initial value of an unknown radius [m]


@dataclass(frozen=True)
class Touch(Relation):
    """Touches of sockets, planes or spheres by one target. The one detail of a reading is the number of the touched
    thing.

    Attributes:
        surface: Kind of the touched surface.
        touched: Names of the touched things, in the order of the detail; `own` has the place of each, or of the
            artefact.
        points_of_artefact: Points in the artefact [m]; none without one.
        ball: Radius of the ball [m].
        radii: Radius of each sphere; or the one of all spheres of the artefact.
        tolerance: Tolerance of the coordinates of the points of the artefact [m]; None: they are exact.
    """

    section = TouchSection
    touches = True
    lacks = "touches nothing called"
    surface: Surface = "socket"
    touched: tuple[str, ...] = ()
    points_of_artefact: tuple[tuple[float, float, float], ...] = ()
    ball: float = 0.0
    radii: tuple[OwnLength, ...] = ()
    tolerance: float | None = None

    @classmethod
    def from_section(cls, name: str, section: TouchSection) -> Touch:
        """Return the instrument that an entry of a robot description means."""
        piece, part = section.artefact, _PARTS[section.surface]
        places = section.places.items() if piece is None else ()
        own = tuple(place.place(key, section.surface) for key, place in places)
        radii = [(key, place.radius) for key, place in places] if piece is None else [(name, piece.radius)]
        unknowns = () if piece is None else _tolerances(name, piece.points, piece.tolerance)
        for key, radius in radii:
            unknowns += () if radius is None else radius.parameters(f"{key}.radius", _RADIUS)
        return cls(
            name,
            section.target or name,
            own if piece is None else (piece.place(f"{name}_artefact"),),
            section.surface,
            tuple(section.places if piece is None else piece.points),
            () if piece is None else tuple(piece.points.values()),
            section.radius,
            tuple(radius or OwnLength() for _, radius in radii),
            None if piece is None else piece.tolerance,
            noise=Noise((PartNoise.from_sigma(section.sigma, len(part.axes)),)),
            unknowns=unknowns,
        )

    @property
    def parts(self) -> tuple[Part, ...]:
        """Three coordinates of a socket, or the gap to a surface."""
        return (_PARTS[self.surface],)

    @property
    def named(self) -> tuple[str, ...]:
        """Return the names of the touched things."""
        return self.touched

    def predict(self, view: View, unknowns: FloatArray, details: FloatArray) -> FloatArray:
        """Return the distance of the ball from contact, (n, 3) or (n, 1) [m]."""
        return self._gap(view, unknowns, details)[0]

    def compare(self, view: View, unknowns: FloatArray, readings: Readings) -> Comparison:
        """Return the distance of the ball from contact, and its derivative by dp."""
        gap, by_motion, by_unknown = self._gap(view, unknowns, readings.details)
        by_twist = np.zeros((len(readings), self.n_rows, 6))
        by_twist[:, :, :3] = by_motion
        return Comparison(gap - readings.values, by_twist, by_unknown)

    def _gap(self, view: View, unknowns: FloatArray, details: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Gaps (n, n_rows), their derivative by dp (n, n_rows, 3) and by the unknowns (n, n_rows, n_unknowns)."""
        n, which = len(details), details[:, 0].astype(np.intp)
        ball = view.translation.copy()
        if self.points_of_artefact:
            points = np.array(self.points_of_artefact)
            if self._n_errors:
                points += unknowns[: self._n_errors].reshape(-1, 3)
            ball -= points[which]
        gap: FloatArray
        by_motion: FloatArray
        if self.surface == "socket":
            gap, by_motion = ball, np.tile(np.eye(3), (n, 1, 1))
        elif self.surface == "plane":
            gap, by_motion = ball[:, 2:] - self.ball, np.tile(np.eye(3)[2:], (n, 1, 1))
        else:
            length, unit = distances(ball, f"instrument '{self.name}': its ball '{self.target}'")
            gap, by_motion = (length - self.ball - self._radius(which, unknowns))[:, None], unit[:, None, :]
        by_unknown = np.zeros((n, self.n_rows, len(self.unknowns)))
        k = np.arange(n)
        for axis in range(3 if self._n_errors else 0):
            by_unknown[k, :, 3 * which + axis] = -by_motion[:, :, axis]
        radius = self.radius_unknown(which)
        by_unknown[k[radius >= 0], :, radius[radius >= 0]] = -1.0
        return gap, by_motion, by_unknown

    @property
    def _n_errors(self) -> int:
        """Number of unknown errors of coordinates of points; they come before the radii."""
        return 3 * len(self.points_of_artefact) if self.tolerance is not None else 0

    def radius_unknown(self, which: IntArray) -> IntArray:
        """Number of the unknown radius of the touched sphere, (n,); -1: it is known."""
        unknown = np.array([radius.unknown for radius in self.radii], dtype=bool)
        return np.where(unknown, self._n_errors + np.cumsum(unknown) - 1, -1)[self.pair_of(which)]

    def _radius(self, which: IntArray, unknowns: FloatArray) -> FloatArray:
        """Radius of the touched sphere, (n,) [m]."""
        known = np.array([radius.value for radius in self.radii])
        number = self.radius_unknown(which)
        stated = known[self.pair_of(which)]
        return np.where(number >= 0, np.append(unknowns, 0.0)[number], stated)


def _tolerances(
    name: str, points: Mapping[str, tuple[float, float, float]], tolerance: float | None
) -> tuple[Parameter, ...]:
    if tolerance is None:
        return ()
    return tuple(
        Parameter(f"{name}.{point}.{axis}", "length", 0.0, tolerance, "mm", True, True)
        for point in points
        for axis in LENGTH_COMPONENTS
    )
