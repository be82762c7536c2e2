"""Where gravity points: as a robot description says, and as sensors read it at each visit.

Compliance and bending need the direction of gravity in the root link of the URDF. It is (0, 0, -1) unless a description
says otherwise: of an arm that hangs from a ceiling, stands on a ramp, or is mounted differently in each setup. A sensor
on any link reads it at each visit: an inclinometer, or an accelerometer at rest, which reads upwards.

Sensors also say how far links are tilted: two joints that are not commanded, such as those between the ground and a
base on tracks, or in a column that bends, take their values from what an inclinometer on the link behind them reads.

A direction d that is not well known is found: it is R_a(t_a) R_b(t_b) d, with turns t about two axes of the root link,
the two that are most nearly across what the description says. A turn about gravity itself would change nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import Field, field_validator

from calib.core.base.arrays import BoolArray, FloatArray
from calib.core.base.errors import DataError
from calib.core.base.sections import PositiveAngle, Section
from calib.core.base.units import Dimension

STANDARD = 9.81
"""Acceleration by gravity [m/s^2]. Pinocchio's; what it misses goes into coefficients that are found."""
_VECTOR = ("gravity_x", "gravity_y", "gravity_z")
_ACCELEROMETER = ("accelerometer_x", "accelerometer_y", "accelerometer_z")
_TILTS = ("gravity_tilt_x", "gravity_tilt_y")
_WAYS = (_VECTOR, _ACCELEROMETER, _TILTS)
COLUMNS: dict[str, Dimension] = {
    **dict.fromkeys((*_VECTOR, *_ACCELEROMETER), "acceleration"),
    **dict.fromkeys(_TILTS, "angle"),
}
"""Columns that say where gravity points at a visit, in the axes of the sensor, and what they measure."""
_LENGTHS_AGREE = 0.05  # by which part the length of a vector that was read may differ from their median
_TILTS_END = np.radians(85.0)  # an inclinometer with two axes tells directions up to here [rad]

_Number = Annotated[float, Field(allow_inf_nan=False)]
Direction = tuple[_Number, _Number, _Number]


class GravitySection(Section):
    """Where gravity points.

    Attributes:
        down: Its direction in the axes of the URDF's root link; any length.
        setups: The same in the setups where it is another one.
        frame: Link in whose axes columns of the measurements say it; the root link if not given. It may move.
        sigma: How far `down`, or the sensor on its link, may be turned (one standard deviation) [rad]; then the
            direction is found. Not given: it is known.
    """

    down: Direction = (0.0, 0.0, -1.0)
    setups: dict[str, Direction] = Field(default_factory=dict)
    frame: str | None = None
    sigma: PositiveAngle | None = None

    @field_validator("down", "setups")
    @classmethod
    def _has_length(cls, value: Any) -> Any:
        for direction in value.values() if isinstance(value, dict) else [value]:
            if not 1e-100 < np.max(np.abs(direction)) < 1e100:  # its square is a number, too
                raise ValueError("a direction of gravity needs a length, such as [0, 0, -1]")
        return value

    @field_validator("sigma")
    @classmethod
    def _is_small(cls, value: float | None) -> float | None:
        if value is not None and value > np.pi / 2:
            raise ValueError(f"{np.degrees(value):.0f} deg means that nothing is known; write a unit, such as '3 deg'")
        return value

    def stated_directions(self, setups: Sequence[str] = ()) -> FloatArray:
        """Return the unit vector of each setup, of the only one where none is named, (n_setups, 3)."""
        rows = np.array([self.setups.get(name, self.down) for name in setups] or [self.down], dtype=float)
        result: FloatArray = rows / np.linalg.norm(rows, axis=1, keepdims=True)
        return result

    @property
    def axes(self) -> tuple[int, int]:
        """Number of the two axes of the root link, about which the direction is turned where it is found."""
        first, second = sorted(np.argsort(np.abs(self.stated_directions()[0]), kind="stable")[:2].tolist())
        return first, second


class InclinometerSection(Section):
    """A sensor that reads where gravity points, and so the angles of two joints that are not commanded.

    Attributes:
        frame: The link that it is on, in whose axes it reads.
        joints: Two joints that turn this link, about axes that are not vertical.
    """

    frame: str
    joints: tuple[str, str]


def columns_of(sensor: str) -> dict[str, Dimension]:
    """Return the columns that an inclinometer of this name may have, and what they measure."""
    return {f"{sensor}_{name}": dimension for name, dimension in COLUMNS.items()}


def read_down(conditions: Mapping[str, FloatArray]) -> FloatArray | None:
    """Return where sensors saw down, unit vectors in their axes, (n, 3); NaN where not, None where never.

    Tilts are those of `calib.core.instruments.orientation`: 0 where the sensor is level, growing by the right hand.

    Args:
        conditions: `COLUMNS` by name, (n,) each [SI].
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
    """Raise `DataError` where columns do not say where gravity points.

    Args:
        conditions: `COLUMNS` by name, (n,) each [SI].
        path: Of the file.
        lines: Of each row in it.
        sensor: What the file has before these names.
    """
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
                f"{path}, line {lines[int(np.argmax(empty))]}: says nothing in {', '.join(columns)}, where other rows"
                " say where gravity points; fill it in, or leave the row out"
            )
        wrong, why = _no_tilts(read) if names is _TILTS else _no_gravity(read)
        if np.any(wrong):
            raise DataError(f"{path}, line {lines[int(np.argmax(wrong))]}: {columns[0][:-2]} {why}")


def _no_tilts(read: FloatArray) -> tuple[BoolArray, str]:
    """Which rows of tilts (n, 2) tell no direction, and why."""
    why = (
        "is a tilt beyond 85 deg, where two tilts tell no direction; without [deg] in its header a column is in rad;"
        " else give gravity_x, gravity_y, gravity_z"
    )
    return np.any(np.abs(read) > _TILTS_END, axis=1), why


def _no_gravity(read: FloatArray) -> tuple[BoolArray, str]:
    """Which rows of vectors (n, 3) cannot be gravity, and why."""
    lengths = np.linalg.norm(read, axis=1)
    usual = float(np.median(lengths))
    wrong = ~(np.abs(lengths - usual) <= _LENGTHS_AGREE * usual) | (lengths == 0)
    why = (
        f"is {lengths[int(np.argmax(wrong))]:.4g} long, and the others {usual:.4g}: gravity is the same at every visit;"
        " the sensor moved, or a number is wrong"
    )
    return wrong, why
