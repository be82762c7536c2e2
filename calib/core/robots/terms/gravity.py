"""Direction of gravity: stated in a robot description, or read by sensors at each visit.

Compliance and bending need the direction of gravity in the root link of the URDF. It is (0, 0, -1) unless a description
says otherwise, such as for an arm that hangs from a ceiling, stands on a ramp, or is mounted differently in each setup.
A sensor on any link may read it at each visit: an inclinometer, or an accelerometer at rest, which reads upwards.

Sensors also measure how far links are tilted. Two joints that are not commanded, such as those between the ground and a
base on tracks, or in a column that bends, take their values from an inclinometer on the link after them.

A direction d that is not well known is fitted as R_a(t_a) R_b(t_b) d, with turns t about two axes of the root link.
These are the two axes most nearly perpendicular to the stated direction: a turn about gravity would change nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import Field, field_validator

from calib.core.base.arrays import BoolArray, FloatArray
from calib.core.base.errors import DataError
from calib.core.base.sections import PositiveAngle, Section
from calib.core.base.units import Dimension, quantity_text

STANDARD = 9.81
"""Acceleration by gravity [m/s^2], as in Pinocchio; fitted coefficients absorb its local deviation."""
_VECTOR = ("gravity_x", "gravity_y", "gravity_z")
_ACCELEROMETER = ("accelerometer_x", "accelerometer_y", "accelerometer_z")
_TILTS = ("gravity_tilt_x", "gravity_tilt_y")
_WAYS = (_VECTOR, _ACCELEROMETER, _TILTS)
COLUMNS: dict[str, Dimension] = {
    **dict.fromkeys((*_VECTOR, *_ACCELEROMETER), "acceleration"),
    **dict.fromkeys(_TILTS, "angle"),
}
"""Columns for the direction of gravity at a visit, in the axes of the sensor, and their dimensions."""
_LENGTHS_AGREE = 0.05  # largest relative difference of the length of a vector from the median length
_TILTS_END = np.radians(85.0)  # largest tilt at which an inclinometer with two axes determines a direction [rad]

_Number = Annotated[float, Field(allow_inf_nan=False)]
Direction = tuple[_Number, _Number, _Number]


class GravitySection(Section):
    """Direction of gravity.

    Attributes:
        down: Direction of gravity in the axes of the URDF's root link; any length.
        setups: The direction in those setups where it is another one.
        frame: Link in whose axes the columns of measurements are given, which may move; the root link if not given.
        sigma: Standard deviation by which `down`, or the sensor on its link, may be turned [rad]; then the direction
            is fitted. Not given: it is known.
    """

    down: Direction = (0.0, 0.0, -1.0)
    setups: dict[str, Direction] = Field(default_factory=dict)
    frame: str | None = None
    sigma: PositiveAngle | None = None

    @field_validator("down", "setups")
    @classmethod
    def _has_length(cls, value: Any) -> Any:
        for direction in value.values() if isinstance(value, dict) else [value]:
            if not 1e-100 < np.max(np.abs(direction)) < 1e100:  # so that its square neither overflows nor vanishes
                raise ValueError("a direction of gravity needs a length, such as [0, 0, -1]")
        return value

    @field_validator("sigma")
    @classmethod
    def _is_small(cls, value: float | None) -> float | None:
        if value is not None and value > np.pi / 2:
            size = quantity_text(value, "deg", ".0f")
            raise ValueError(f"{size} means that nothing is known; write a unit, such as '3 deg'")
        return value

    def stated_directions(self, setups: Sequence[str] = ()) -> FloatArray:
        """Return the stated unit vector of each setup, (n_setups, 3); one row if no setups are named."""
        rows = np.array([self.setups.get(name, self.down) for name in setups] or [self.down], dtype=float)
        return rows / np.linalg.norm(rows, axis=1, keepdims=True)

    @property
    def axes(self) -> tuple[int, int]:
        """Indices of the two axes of the root link about which a fitted direction is turned."""
        first, second = sorted(np.argsort(np.abs(self.stated_directions()[0]), kind="stable")[:2].tolist())
        return first, second


class InclinometerSection(Section):
    """A sensor on the link `frame` that reads the direction of gravity there, and so two angles that are not commanded.

    They are those of two joints that turn this link, about axes that are not vertical.
    """

    frame: str
    joints: tuple[str, str]


def columns_of(sensor: str) -> dict[str, Dimension]:
    """Return the columns that an inclinometer of this name may have, and what they measure."""
    return {f"{sensor}_{name}": dimension for name, dimension in COLUMNS.items()}


def read_down(conditions: Mapping[str, FloatArray]) -> FloatArray | None:
    """Return the direction of gravity that sensors read, (n, 3), in their axes; NaN where not read, None if never.

    Tilts are defined in `calib.core.instruments.orientation`: 0 where the sensor is level, right-handed. `conditions`
    are `COLUMNS` by name, (n,) each [SI].
    """
    down: FloatArray | None = None
    for names in _WAYS:
        if not all(name in conditions for name in names):
            continue
        read = np.stack([conditions[name] for name in names], axis=1)
        if names is _TILTS:
            slopes = np.tan(read)
            read = np.stack([slopes[:, 1], -slopes[:, 0], -np.ones(len(read))], axis=1)
        elif names is _ACCELEROMETER:
            read = -read
        with np.errstate(invalid="ignore"):
            read = read / np.linalg.norm(read, axis=1, keepdims=True)
        down = read if down is None else np.where(np.isnan(down), read, down)
    return down


def check_read(conditions: Mapping[str, FloatArray], path: str, lines: Sequence[int], sensor: str = "") -> None:
    """Raise `DataError` where `COLUMNS` (n,) do not determine gravity; a `sensor` has this prefix in the file."""
    having = [names for names in _WAYS if any(name in conditions for name in names)]
    if len(having) > 1:
        first, second = (sensor + next(name for name in names if name in conditions) for names in having[:2])
        raise DataError(f"{path}: columns '{first}' and '{second}' both say where gravity points; leave one out")
    for names in having:
        missing = next((name for name in names if name not in conditions), None)
        columns = [sensor + name for name in names]
        if missing is not None:
            raise DataError(f"{path}: no column '{sensor}{missing}'; gravity's direction needs {', '.join(columns)}")
        read = np.stack([conditions[name] for name in names], axis=1)
        empty = np.isnan(read).any(axis=1)
        if np.any(empty):
            raise DataError(
                f"{path}, line {lines[int(np.argmax(empty))]}: a cell of {', '.join(columns)} is empty, but"
                " other rows state the direction of gravity; fill it in, or leave the row out"
            )
        wrong, why = _no_tilts(read) if names is _TILTS else _no_gravity(read)
        if np.any(wrong):
            raise DataError(f"{path}, line {lines[int(np.argmax(wrong))]}: {columns[0][:-2]} {why}")


def _no_tilts(read: FloatArray) -> tuple[BoolArray, str]:
    """Rows of tilts (n, 2) that determine no direction, and why."""
    why = (
        "is a tilt beyond 85 deg, where two tilts give no direction. Without [deg] in its header a column is in rad."
        " For such tilts give gravity_x, gravity_y, gravity_z"
    )
    return np.any(np.abs(read) > _TILTS_END, axis=1), why


def _no_gravity(read: FloatArray) -> tuple[BoolArray, str]:
    """Rows of vectors (n, 3) that cannot be gravity, and why."""
    lengths = np.linalg.norm(read, axis=1)
    usual = float(np.median(lengths))
    wrong = ~(np.abs(lengths - usual) <= _LENGTHS_AGREE * usual) | (lengths == 0)
    why = (
        f"is {lengths[int(np.argmax(wrong))]:.4g} long, and the others {usual:.4g}: gravity is the same at every visit;"
        " the sensor moved, or a number is wrong"
    )
    return wrong, why
