"""What the sections of a robot description are made of: components of an origin, quantities with units."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, PlainValidator

from calib.errors import InputError
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


def _number_or_text(value: Any) -> float | str:
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        raise ValueError(f"{value!r:.60} is not a number with a unit, such as '0.04 mm' or '1.5 deg'")
    return value


Length = Annotated[float, _reader("length")]
Angle = Annotated[float, _reader("angle")]
Quantity = Annotated[float | str, PlainValidator(_number_or_text)]
"""A number, or text with a unit, whose dimension is known only later."""


class Section(BaseModel):
    """A mapping of keys in a robot description; unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True)
