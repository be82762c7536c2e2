"""The robot description: a YAML file that says what a URDF cannot.

Which joints have motors, where the loops close and in which directions, one assembled configuration, where the
measurements are taken, which origins may be wrong and by how much. Keys `name_mot`, `closed_loop` and `type` are those
of Pinocchio's toolbox-parallel-robots. Lengths and angles are SI, or text with a unit (`0.04 mm`, `1.5 deg`).
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from calib.errors import DescriptionError, InputError, nearest
from calib.units import Dimension, quantity

Component = Literal["x", "y", "z", "rx", "ry", "rz"]
LENGTH_COMPONENTS: tuple[Component, ...] = ("x", "y", "z")
ANGLE_COMPONENTS: tuple[Component, ...] = ("rx", "ry", "rz")
COMPONENTS = LENGTH_COMPONENTS + ANGLE_COMPONENTS


def _reader(dimension: Dimension) -> BeforeValidator:
    def read(value: Any) -> float:
        try:
            return quantity(value, dimension, "value")
        except InputError as error:
            raise ValueError(str(error).removeprefix("value: ")) from None

    return BeforeValidator(read)


Length = Annotated[float, _reader("length")]
Angle = Annotated[float, _reader("angle")]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class BaseSection(_Section):
    """The frame in which positions are measured.

    Attributes:
        frame: Link that it is attached to.
        xyz, rpy: Pose of that link in the measurement frame [m], [rad].
        pose: `known`: that pose is right; `unknown`: it is found from the measurements.
    """

    frame: str
    xyz: tuple[Length, Length, Length] = (0.0, 0.0, 0.0)
    rpy: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    pose: Literal["known", "unknown"] = "known"


class TargetSection(_Section):
    """A measured point.

    Attributes:
        frame: Link that carries it.
        xyz: Where it is in that link [m].
        position: `known`: it is right there; `unknown`: found from the measurements, starting from `xyz`.
        sigma: How far an unknown position may be from `xyz` (one standard deviation) [m]; left out, `xyz` says nothing.
            Give it if you can: joints that hardly turned during the measurements leave the point loosely determined.
    """

    frame: str
    xyz: tuple[Length, Length, Length] = (0.0, 0.0, 0.0)
    position: Literal["known", "unknown"] = "known"
    sigma: Annotated[Length, Field(gt=0)] | None = None

    @model_validator(mode="after")
    def _sigma_of_unknown(self) -> TargetSection:
        if self.sigma is not None and self.position == "known":
            raise ValueError("sigma is for a target whose position is unknown")
        return self


class OriginSection(_Section):
    """Components of joint origins that may be wrong.

    Attributes:
        origin: A joint's name, `all` (every joint origin that moves a target), `base`, or a target's name.
        components: Of x, y, z (translation, in the parent link) and rx, ry, rz (rotation vector in the joint frame).
        sigma: How far each is expected to be off (one standard deviation), with its unit.
        unit: Unit in tables; mm and deg if not given.
    """

    origin: str
    components: tuple[Component, ...] = Field(min_length=1)
    sigma: str | float
    unit: str | None = None

    @model_validator(mode="after")
    def _one_dimension(self) -> OriginSection:
        if len({component in LENGTH_COMPONENTS for component in self.components}) > 1:
            raise ValueError("lengths (x, y, z) and angles (rx, ry, rz) need entries of their own")
        return self

    @property
    def dimension(self) -> Dimension:
        """Whether these components are lengths or angles."""
        return "length" if self.components[0] in LENGTH_COMPONENTS else "angle"


class Description(_Section):
    """A robot description, as the YAML file has it. See docs/robot_description.md for every key."""

    urdf: str
    name_mot: tuple[str, ...] = Field(min_length=1)
    closed_loop: tuple[tuple[str, str], ...] = ()
    type: tuple[Literal["3d", "6d"], ...] = ()
    closed_loop_axes: tuple[tuple[Component, ...], ...] | None = None
    home: dict[str, float | str] = {}
    base: BaseSection
    targets: dict[str, TargetSection] = Field(min_length=1)
    parametrisation: str | tuple[OriginSection, ...]
    held: tuple[str, ...] = ()
    priors: bool = True
    sigma: Annotated[Length, Field(gt=0)] | None = None
    singularity_limit: Annotated[float, Field(gt=0, lt=1)] = 0.02
    columns: dict[str, str] = {}

    @model_validator(mode="after")
    def _loops_agree(self) -> Description:
        if len(self.type) != len(self.closed_loop):
            raise ValueError(
                f"'type' has {len(self.type)} entries for {len(self.closed_loop)} entries of 'closed_loop'"
            )
        if self.closed_loop_axes is not None and len(self.closed_loop_axes) != len(self.closed_loop):
            raise ValueError(
                f"'closed_loop_axes' has {len(self.closed_loop_axes)} entries for"
                f" {len(self.closed_loop)} entries of 'closed_loop'"
            )
        return self

    def loop_axes(self, index: int) -> tuple[Component, ...]:
        """Constrained directions of one closure: as given, or all that its type has."""
        if self.closed_loop_axes is not None:
            return self.closed_loop_axes[index]
        return COMPONENTS if self.type[index] == "6d" else LENGTH_COMPONENTS


class _UniqueKeyLoader(yaml.SafeLoader):
    """YAML silently keeps the last of two equal keys; here that is an error."""


def _unique_mapping(loader: yaml.SafeLoader, node: yaml.MappingNode) -> dict[Any, Any]:
    seen: set[Any] = set()
    for key_node, _ in node.value:
        key = loader.construct_object(key_node, deep=True)
        if key in seen:
            raise yaml.constructor.ConstructorError(None, None, f"key '{key}' is given twice", key_node.start_mark)
        seen.add(key)
    return loader.construct_mapping(node, deep=True)


_UniqueKeyLoader.add_constructor(yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, _unique_mapping)


def read_description(path: Path | str) -> Description:
    """Read and validate a robot description.

    Raises:
        DescriptionError: Missing file, broken YAML, unknown key, wrong value; the message names the place.
    """
    try:
        content = yaml.load(Path(path).read_text(encoding="utf-8-sig"), Loader=_UniqueKeyLoader)
    except FileNotFoundError:
        raise DescriptionError(f"{path}: no such file; give a robot description (YAML) or a URDF") from None
    except (OSError, UnicodeDecodeError) as error:
        raise DescriptionError(f"{path}: cannot be read as UTF-8 text ({error})") from None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f", line {mark.line + 1}" if mark else ""
        problem = getattr(error, "problem", None) or "cannot be parsed"
        raise DescriptionError(f"{path}{line}: not valid YAML ({problem})") from None
    if not isinstance(content, dict):
        raise DescriptionError(
            f"{path}: is not a mapping of keys to values; `calib init URDF` writes one to start from"
        )
    try:
        return Description.model_validate(content)
    except ValidationError as error:
        raise DescriptionError(f"{path}: {_one_line(error)}") from None


def _one_line(error: ValidationError) -> str:
    """Turn pydantic's first complaint into one line: where, what, and the nearest valid key."""
    first = error.errors()[0]
    place = ".".join(str(part) for part in first["loc"] if not str(part).startswith(("function-", "tuple[", "str")))
    if first["type"] == "extra_forbidden":
        key = str(first["loc"][-1])
        return f"unknown key '{place}'{nearest(key, _valid_keys(first['loc']))}"
    if first["type"] == "missing":
        return f"key '{place}' is missing"
    message = first["msg"].removeprefix("Value error, ")
    message = message[:1].lower() + message[1:]
    given = first["input"]
    shown = "" if isinstance(given, (dict, list)) or first["type"] == "value_error" else f" (given: {given!r})"
    return (f"{place}: " if place else "") + message + shown


def _valid_keys(location: tuple[int | str, ...]) -> list[str]:
    sections: dict[str, type[_Section]] = {
        "base": BaseSection,
        "targets": TargetSection,
        "parametrisation": OriginSection,
    }
    section = sections.get(str(location[0]), Description) if len(location) > 1 else Description
    return list(section.model_fields)
