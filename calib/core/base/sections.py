"""Parts of the sections of a robot description: components of an origin, quantities with units.

Also own lengths of instruments, such as the radius of a sphere: known, expected near a value, or unknown; and the
reader of YAML, in which a mistake is an error with its line, and so is a key given twice.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, LiteralString, Self

import yaml
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    PlainValidator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from calib.core.base.errors import DescriptionError, nearest, require_known
from calib.core.base.files import read_text
from calib.core.base.letters import unseen
from calib.core.base.parameter import Parameter
from calib.core.base.units import Dimension, plain_quantity, quantity

Component = Literal["x", "y", "z", "rx", "ry", "rz"]
LENGTH_COMPONENTS: tuple[Component, ...] = ("x", "y", "z")
ANGLE_COMPONENTS: tuple[Component, ...] = ("rx", "ry", "rz")
COMPONENTS = LENGTH_COMPONENTS + ANGLE_COMPONENTS
_SCALE = 0.01  # scale of an unknown length without a prior [m]
_KEYS = ("value", "sigma")
_MERGE = "tag:yaml.org,2002:merge"
_OPENCV_MATRIX = "tag:yaml.org,2002:opencv-matrix"
_MOST_BY_ALIASES = 10_000
"""Entries that aliases may add, because a few lines with aliases can expand to more than memory holds."""


class _ValueError(ValueError):
    """A wrong value; pydantic adds the place of its key in the description."""

    def __init__(self, message: str) -> None:
        super().__init__(message.removeprefix("value: "))


def _reader(dimension: Dimension) -> BeforeValidator:
    def read(value: Any) -> float:
        return quantity(value, dimension, "value", _ValueError)

    return BeforeValidator(read, json_schema_input_type=float | str)


def _writer(dimension: Dimension) -> PlainSerializer:
    def write(value: float) -> float | str:
        return plain_quantity(value, dimension)

    return PlainSerializer(write, when_used="json")


UNKNOWN_KEY: LiteralString = "unknown_key"
"""Type of the error of a key that a section does not have; its context has the key, and a hint at the nearest one."""


def _number_or_text(value: Any) -> float | str:
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        raise ValueError(f"{value!r:.60} is not a number with a unit, such as '0.04 mm' or '1.5 deg'")
    huge = isinstance(value, int) and abs(value) >= 10**300  # `quantity` refuses it with its own sentence
    return value if huge or isinstance(value, str) else float(value)


Length = Annotated[float, _reader("length"), _writer("length")]
Angle = Annotated[float, _reader("angle"), _writer("angle")]
Pixels = Annotated[float, _reader("pixel")]
PositiveLength = Annotated[Length, Field(gt=0)]
PositiveAngle = Annotated[Angle, Field(gt=0)]
Quantity = Annotated[float | str, PlainValidator(_number_or_text, json_schema_input_type=float | str)]
"""A number, or text with a unit, whose dimension is known only later."""


class Section(BaseModel):
    """A mapping of keys in a robot description; unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, value: Any) -> Any:
        for key in value if isinstance(value, dict) else ():
            if isinstance(key, str) and key not in cls.model_fields:
                hint = nearest(key, cls.model_fields)
                raise PydanticCustomError(UNKNOWN_KEY, "unknown key '{key}'{hint}", {"key": key, "hint": hint})
        return value


class FrameSection(Section):
    """A frame on a link.

    Attributes:
        frame: The link.
        xyz, rpy: Position [m] and orientation [rad] in that link.
    """

    frame: str
    xyz: tuple[Length, Length, Length] = (0.0, 0.0, 0.0)
    rpy: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)


class PlaceSection(FrameSection):
    """A frame on a link; position and orientation are each known or not.

    Attributes:
        position: `known`: it is exactly `xyz`; `unknown`: found from the measurements, starting from `xyz`.
        orientation: The same for `rpy`.
        sigma: Expected distance of an unknown position from `xyz`, one sigma [m]; None: `xyz` is only a start.
        sigma_angle: The same for an unknown orientation [rad].
    """

    what: ClassVar[str]
    position: Literal["known", "unknown"] = "known"
    orientation: Literal["known", "unknown"] = "known"
    sigma: PositiveLength | None = None
    sigma_angle: PositiveAngle | None = None

    @property
    def unknown(self) -> tuple[Component, ...]:
        """Components that the measurements must find."""
        lengths = LENGTH_COMPONENTS if self.position == "unknown" else ()
        return lengths + (ANGLE_COMPONENTS if self.orientation == "unknown" else ())

    @model_validator(mode="after")
    def _sigma_of_unknown(self) -> Self:
        if self.sigma is not None and self.position == "known":
            raise ValueError(f"sigma is for a {self.what} whose position is unknown")
        if self.sigma_angle is not None and self.orientation == "known":
            raise ValueError(f"sigma_angle is for a {self.what} whose orientation is unknown")
        return self


class PosedSection(FrameSection):
    """A frame on a link whose pose is known or not.

    Attributes:
        pose: `known`: exactly `xyz` and `rpy`; `unknown`: found from the measurements, starting from these.
        sigma, sigma_angle: How far an unknown pose may be from these, one standard deviation [m], [rad]; without
            them, `xyz` and `rpy` are only a start.
    """

    what: ClassVar[str]
    pose: Literal["known", "unknown"] = "known"
    sigma: PositiveLength | None = None
    sigma_angle: PositiveAngle | None = None

    @property
    def unknown(self) -> tuple[Component, ...]:
        """Components that the measurements must find."""
        return COMPONENTS if self.pose == "unknown" else ()

    @model_validator(mode="after")
    def _sigma_of_unknown(self) -> Self:
        if self.pose == "known" and (self.sigma is not None or self.sigma_angle is not None):
            raise ValueError(f"sigma and sigma_angle are for {self.what} whose pose is unknown")
        return self


@dataclass(frozen=True)
class OwnLength:
    """A length that belongs to an instrument.

    Attributes:
        value: Its actual or expected length [m].
        unknown: Whether the measurements must find it.
        sigma: How far an unknown one may be from `value`, one standard deviation [m]; None: `value` is only a start.
    """

    value: float = 0.0
    unknown: bool = False
    sigma: float | None = None

    def parameters(self, name: str, start: float | None = None) -> tuple[Parameter, ...]:
        """Return the length as an unknown, `start` [m] where nothing is expected; nothing if it is known."""
        if not self.unknown:
            return ()
        nominal = self.value if self.sigma is not None or start is None else start
        sigma = _SCALE if self.sigma is None else self.sigma
        return (Parameter(name, "length", nominal, sigma, "mm", self.sigma is not None, True),)


KNOWN_ZERO = OwnLength()


def _read(value: Any) -> OwnLength:
    if isinstance(value, OwnLength):
        return value
    if value == "unknown":
        return OwnLength(unknown=True)
    if not isinstance(value, dict):
        return OwnLength(quantity(value, "length", "value", _ValueError))
    for key in value:
        require_known(str(key), _KEYS, "unknown key", ValueError)
    if set(value) != set(_KEYS):
        raise ValueError("give {value: ..., sigma: ...}; or a number alone if it is exact, or 'unknown'")
    sigma = quantity(value["sigma"], "length", "sigma", _ValueError)
    if sigma <= 0:
        raise ValueError("sigma must be positive; give a number alone if it is exact")
    return OwnLength(quantity(value["value"], "length", "value", _ValueError), True, sigma)


def _to_yaml(length: OwnLength) -> float | str | dict[str, float | str]:
    value = plain_quantity(length.value, "length")
    if not length.unknown:
        return value
    return "unknown" if length.sigma is None else {"value": value, "sigma": plain_quantity(length.sigma, "length")}


LengthOrUnknown = Annotated[OwnLength, PlainValidator(_read), PlainSerializer(_to_yaml)]
"""`12 mm`: known; `{value: 12 mm, sigma: 0.1 mm}`: found, with this prior; `unknown`: found, without a prior."""


def _positive(length: OwnLength) -> OwnLength:
    if length.value <= 0:
        raise ValueError("must be positive: a length, or {value, sigma}")
    return length


PositiveLengthOrUnknown = Annotated[LengthOrUnknown, AfterValidator(_positive)]
"""The same for a positive length."""


class _Loader(yaml.SafeLoader):
    """The YAML that is read here: without boundless aliases, and without a key twice (YAML silently keeps the last)."""

    def compose_document(self) -> yaml.Node | None:
        """Return the nodes of a document; aliases that expand it too much, or contain themselves, are an error."""
        document = super().compose_document()
        sizes: dict[int, int] = {}
        if document is not None and _size(document, sizes) - len(sizes) > _MOST_BY_ALIASES:
            problem = f"its YAML aliases (*NAME) expand to more than {_MOST_BY_ALIASES} entries"
            raise yaml.composer.ComposerError(None, None, problem, document.start_mark)
        return document


def _size(node: yaml.Node, sizes: dict[int, int]) -> int:
    """Number of entries of a node, with its aliases written out; `sizes` has the known numbers of nodes."""
    if id(node) not in sizes:
        sizes[id(node)] = 0  # as long as its parts are being counted
        if isinstance(node, yaml.ScalarNode) and (problem := unseen(node.value)):
            raise yaml.composer.ComposerError(None, None, problem, node.start_mark)
        parts = node.value if isinstance(node, yaml.CollectionNode) else ()
        sizes[id(node)] = 1 + sum(
            _size(part, sizes) for entry in parts for part in (entry if isinstance(entry, tuple) else (entry,))
        )
    elif sizes[id(node)] == 0:
        raise yaml.composer.ComposerError(None, None, "an entry contains itself by an alias", node.start_mark)
    return sizes[id(node)]


def _unique_mapping(loader: yaml.SafeLoader, node: yaml.MappingNode) -> dict[Any, Any]:
    seen: set[Any] = set()
    for key_node, _ in node.value:
        if key_node.tag == _MERGE:
            continue
        key = loader.construct_object(key_node, deep=True)
        if not isinstance(key, Hashable):
            raise yaml.constructor.ConstructorError(None, None, "a key is a list or a mapping", key_node.start_mark)
        if key in seen:
            raise yaml.constructor.ConstructorError(None, None, f"key '{key}' is given twice", key_node.start_mark)
        seen.add(key)
    return loader.construct_mapping(node, deep=True)


# No, Yes, On and Off are words, such as names of columns; true and false alone are truth values
_Loader.yaml_implicit_resolvers = {
    first: [kind for kind in kinds if kind[0] != "tag:yaml.org,2002:bool" or first in "tTfF"]
    for first, kinds in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
for _tag in (yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, _OPENCV_MATRIX):
    _Loader.add_constructor(_tag, _unique_mapping)


def read_yaml(path: Path | str, what: str = "a robot description (YAML) or a URDF") -> object:
    """Read a YAML file, of content `what`; a `DescriptionError` names the line where it is broken."""
    return parse_yaml(read_text(path, what, DescriptionError), path)


def parse_yaml(text: str, where: Path | str) -> Any:
    """Return what YAML says; a `DescriptionError` names the line of broken YAML, or of aliases for very much."""
    try:
        return yaml.load(text, Loader=_Loader)
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # ValueError: such as a date that does not exist
        mark = getattr(error, "problem_mark", None)
        line = f", line {mark.line + 1}" if mark else ""
        problem = getattr(error, "problem", None) or getattr(error, "reason", None) or str(error)
        raise DescriptionError(f"{where}{line}: not valid YAML ({problem})") from None
