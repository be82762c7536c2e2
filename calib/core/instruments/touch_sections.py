"""The entry of touches in a robot description: the places that are touched, one by one or as an artefact."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
import pinocchio as pin
from pydantic import Field, model_validator

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
from calib.core.instruments.kind import InstrumentSection, Place, placed
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
        names = list(self.points)
        for k, name in enumerate(names):
            again = next((other for other in names[:k] if self.points[other] == self.points[name]), None)
            if again is not None:
                raise ValueError(f"the points '{again}' and '{name}' are at the same place")
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
