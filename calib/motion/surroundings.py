"""Shapes in a robot description: around the robot, on it, and the line of sight to it.

This module has only the entries. Others of `calib.motion` make shapes of them, and check which poses are free.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    PlainValidator,
    TypeAdapter,
    ValidationInfo,
    model_validator,
)

from calib.core.base.sections import Angle, Length, PositiveLength, Section

CORNER_CUBE = 0.5235987755982988
"""Angle from its axis within which a corner cube is seen [rad]: 30 deg, as makers of spherical reflectors state."""
FLOOR, UNCHECKED = "floor", "unchecked"
KINDS = ("box", "cylinder", "sphere", "mesh", "plane")
_Three = tuple[Length, Length, Length]


def _file_beside(file: str, info: ValidationInfo) -> str:
    """A file named relative to the description, by a name that also holds elsewhere."""
    folder: Path | None = (info.context or {}).get("folder")
    return file if folder is None else str((folder / file).resolve())


class ShapeSection(Section):
    """One shape, in the axes of the frame that carries it.

    Attributes:
        box: Edge lengths [m].
        cylinder: Radius and length, along z [m].
        sphere: Radius [m].
        mesh: File, relative to the description.
        scale: Factor of the mesh's numbers; 0.001 where they are millimetres.
        xyz, rpy: Where the shape's middle is (a mesh's own origin), and how it is turned [m], [rad].
    """

    box: tuple[PositiveLength, PositiveLength, PositiveLength] | None = None
    cylinder: tuple[PositiveLength, PositiveLength] | None = None
    sphere: PositiveLength | None = None
    mesh: Annotated[str, AfterValidator(_file_beside)] | None = None
    scale: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 1.0
    xyz: _Three = (0.0, 0.0, 0.0)
    rpy: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)

    @property
    def kind(self) -> str:
        """Kind of the shape, one of `KINDS`."""
        return next(kind for kind in KINDS if getattr(self, kind, None) not in (None, False))

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        valid = [kind for kind in KINDS if kind in type(self).model_fields]
        given = [kind for kind in valid if getattr(self, kind) not in (None, False)]
        if len(given) != 1:
            raise ValueError(f"needs one shape of {', '.join(valid)} (given: {', '.join(given) or 'none'})")
        return self


class ObstacleSection(ShapeSection):
    """A thing that the robot must not touch; on a link that moves, a part of the tool.

    Attributes:
        plane: True: everything below z = 0 of its own axes.
        frame: The link that it stands on; the root link if left out.
        clearance: Distance that the robot keeps from it [m].
    """

    plane: bool = False
    frame: str | None = None
    clearance: Annotated[Length, Field(ge=0)] = 0.01


class AcceptanceSection(Section):
    """Directions in which a target is seen.

    Attributes:
        angle: How far off its axis [rad].
        axis: Where it faces, in its own frame.
    """

    angle: Annotated[Angle, Field(gt=0, le=3.1415926535897931)] = CORNER_CUBE
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)

    @model_validator(mode="after")
    def _require_axis(self) -> Self:
        if not 0 < sum(abs(part) for part in self.axis) < float("inf"):
            raise ValueError("axis: needs a direction, such as [0, 0, 1]")
        return self


class SightSection(Section):
    """Position of an instrument that sees the targets in a straight line, such as a laser tracker.

    Attributes:
        frame: The link that it stands on; the root link if left out.
        xyz: Where its beam starts [m].
        width: Width of the free space that the beam needs [m].
    """

    frame: str | None = None
    xyz: _Three
    width: PositiveLength = 0.01


def _obstacles(given: Any, info: ValidationInfo) -> Any:
    """The obstacles of a description, or of their short forms: a word, or a list of words."""
    if given == UNCHECKED:
        return given
    given = [given] if isinstance(given, str) else given
    if isinstance(given, (list, tuple)):
        given = dict.fromkeys(given) if all(isinstance(name, str) for name in given) else given
    if isinstance(given, dict):
        given = {name: _floor(name, value) for name, value in given.items()}
    return TypeAdapter(dict[str, ObstacleSection]).validate_python(given, context=info.context)


def _floor(name: Any, value: Any) -> Any:
    if value == FLOOR or (value is None and name == FLOOR):
        return {"plane": True}
    if isinstance(value, str):
        raise ValueError(f"{name}: '{value:.60}' is no obstacle; write {FLOOR}, or a shape such as {{sphere: 50 mm}}")
    return value


Obstacles = Annotated[
    Any,
    PlainValidator(
        _obstacles,
        json_schema_input_type=dict[str, ObstacleSection | Literal["floor"] | None] | Literal["floor", "unchecked"],
    ),
]
"""Obstacles by name, or `floor` alone. `unchecked`: collisions are not checked."""


def _acceptance(given: Any) -> Any:
    return {"angle": given} if isinstance(given, (int, float, str)) and not isinstance(given, bool) else given


Acceptance = Annotated[
    AcceptanceSection, BeforeValidator(_acceptance, json_schema_input_type=AcceptanceSection | float | str)
]
"""A single angle is about the target's z axis."""
