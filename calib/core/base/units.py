"""Units at the edges: files and reports speak mm and degrees, everything inside is SI (m, rad).

The tables hold how many of a unit make one SI unit, so that `178 mm` becomes the float nearest to 0.178
(a division rounds once; multiplying by the inexact 1e-3 would not).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Literal, TypeVar

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import CalibrationError, DataError, InputError, nearest

Values = TypeVar("Values", float, FloatArray)
Number = TypeVar("Number")
Dimension = Literal["length", "angle", "pixel", "time", "temperature", "mass", "acceleration", "number"]

PER_SI: dict[Dimension, dict[str, float]] = {
    "length": {"m": 1.0, "mm": 1e3, "um": 1e6},
    "angle": {"rad": 1.0, "deg": 180.0 / math.pi, "mrad": 1e3, "urad": 1e6, "arcsec": 648000.0 / math.pi},
    "pixel": {"px": 1.0},
    "time": {"s": 1.0, "min": 1.0 / 60.0, "h": 1.0 / 3600.0},
    "temperature": {"degC": 1.0},
    "mass": {"kg": 1.0},
    "acceleration": {"m/s^2": 1.0},
    "number": {"1": 1.0},
}
_SIGNS = {"°": "deg", "°C": "degC", "\N{MICRO SIGN}m": "um", "\N{GREEK SMALL LETTER MU}m": "um"}
DISPLAY_UNIT: dict[Dimension, str] = {dimension: next(iter(units)) for dimension, units in PER_SI.items()} | {
    "length": "mm",
    "angle": "deg",
}
"""Units of values in files and tables."""
ERROR_UNIT: dict[Dimension, str] = DISPLAY_UNIT | {"angle": "mrad"}
"""Units of errors."""
_SCALES = {unit: scale for units in PER_SI.values() for unit, scale in units.items()}
_QUANTITY = re.compile(r"^\s*([-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?)\s*([A-Za-z°µ\u03bc]*)\s*$")
_COLUMN = re.compile(r"^\s*(?P<name>.*?)\s*(?:\[\s*(?P<unit>[^\[\]]*?)\s*\])?\s*$", re.DOTALL)
_UNIT = "|".join(map(re.escape, (*_SIGNS, *PER_SI["length"], *PER_SI["angle"])))
_OTHERWISE = re.compile(
    rf"^(?:(?P<name>.*?\S)\s*\((?P<unit>[^()]*)\)|(?P<lead>[^/]*[^/\s])\s*/\s*(?P<slash>{_UNIT}))$", re.DOTALL
)
_UNITS = {*_SIGNS, *(unit for units in PER_SI.values() for unit in units if unit != "1")}
_SUSPICIOUS: dict[Dimension, tuple[float, str]] = {"angle": (4 * math.pi, "rad"), "length": (50.0, "m")}
_SMALLEST, _LARGEST = 1e-30, 1e9  # [SI]
_TOLERANCE, _ALIKE = "tolerance", 0.8
_STATEMENT = re.compile(r"^(\w+)\s*[:=]\s*(.*\S)\s*$")
_NUMBER = r"\d+(?:\.\d*)?(?:[eE][-+]?\d+)?|\.\d+"
_FORM = re.compile(
    rf"(?P<sign>-\s*)?(?:(?P<factor>{_NUMBER})\s*\*\s*)?(?P<name>\S(?:.*?\S)?)(?:\s+(?P<way>[-+])\s*(?P<offset>{_NUMBER}))?"
)


def per_si(unit: str | None, dimension: Dimension, where: str, error: type[Exception] = InputError) -> float:
    """Return how many of `unit` make one SI unit; divide by it to get SI. None or "" means SI.

    A unit that is unknown, or of another dimension, raises the `error`, an `InputError`; `where` names the thing.
    """
    units = PER_SI[dimension]
    if not unit:
        return 1.0
    unit = _SIGNS.get(unit, unit)
    if unit in units:
        return units[unit]
    other = next((name for name, of_other in PER_SI.items() if unit in of_other), None)
    if other is not None:
        raise error(
            f"{where}: unit '{unit}' is for {_article(other)}; {_article(dimension)} is expected ({', '.join(units)})"
        )
    raise error(f"{where}: unknown unit '{unit}'{nearest(unit, units)}")


def _article(noun: str) -> str:
    return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"


def quantity(value: object, dimension: Dimension, where: str, error: type[Exception] = InputError) -> float:
    """Read `0.04 mm`, `1.5 deg` or a bare SI number, and return it in SI.

    >>> quantity("178 mm", "length", "a link")
    0.178

    Raises:
        InputError: Or the given `error`: the value is not a finite number with an optional unit of this dimension, or
            it is so large or small that its square would overflow or vanish, or so large without a unit that it cannot
            be SI.
    """
    number, unit = math.nan, None
    if isinstance(value, int) and not isinstance(value, bool):
        number = float(value) if abs(value) < 10**300 else math.inf
    elif isinstance(value, float):
        number = value
    elif isinstance(value, str) and (match := _QUANTITY.match(value)):
        number, unit = float(match.group(1)), match.group(2)
    if not math.isfinite(number):
        example = "0.04 mm" if dimension == "length" else "1.5 deg"
        raise error(f"{where}: {value!r:.60} is not a finite number with a unit, such as '{example}'")
    si = number / per_si(unit, dimension, where, error)
    if si != 0 and not _SMALLEST <= abs(si) <= _LARGEST:
        size = "large" if abs(si) > 1 else "small"
        raise error(f"{where}: {value!r:.60} is too {size} to mean anything; correct it")
    if not unit:
        example = f"'{number:g} {DISPLAY_UNIT[dimension]}'"
        check_plausible(number, dimension, where, f"after the number, such as {example}", error)
    return si


def check_plausible(
    value: float, dimension: Dimension, where: str, place: str, error: type[Exception] = DataError
) -> None:
    """Raise the `error`, a `DataError`, if a number without a unit is so large that it cannot be SI.

    `place` is where to write the unit, such as `into the header`.
    """
    limit, si = _SUSPICIOUS.get(dimension, (math.inf, ""))
    if abs(value) > limit:
        unit = DISPLAY_UNIT[dimension]
        raise error(f"{where}: {value:g} {si} is not plausible; write the unit {place}: {unit}, or {si} if it is right")


def plain_quantity(value: float, dimension: Dimension) -> float | str:
    """Return an SI value as `quantity` reads it: a number, with its unit where it would not be plausible without.

    >>> plain_quantity(0.5, "length"), plain_quantity(60.0, "length")
    (0.5, '60.0 m')
    """
    limit, si = _SUSPICIOUS.get(dimension, (math.inf, ""))
    return f"{value!r} {si}" if abs(value) > limit else value


def stated_tolerance(comments: Iterable[str], path: str, error: type[CalibrationError] = DataError) -> float | None:
    """Return the smallest tolerance that comments (without their #) of a file state [m], `tolerance: 0.1 mm`, or None.

    One that is not a positive length with a unit, or whose key is misspelled, raises the `error`, a `CalibrationError`.
    """
    found = []
    for key, text in (match.groups() for match in map(_STATEMENT.match, comments) if match):
        if not get_close_matches(key.casefold(), [_TOLERANCE], cutoff=_ALIKE):
            continue
        if key.casefold() != _TOLERANCE:
            raise error(f"{path}: comment '{key}: {text}': did you mean '{_TOLERANCE}'?")
        where = f"{path}: comment '{key}: {text}'"
        size = quantity(text, "length", where, error) if re.search(r"[^\d.eE+-]", text) else 0.0
        if size <= 0:
            raise error(
                f"{where}: is not a positive length with a unit; write '# {_TOLERANCE}: 0.1 mm', or leave the line out"
            )
        found.append(size)
    return min(found, default=None)


def sigma_in_si(sigma: Number | str) -> Number | float:
    """Return the noise of positions [m], or None, as it is; text with a unit, such as `0.04 mm`, in m."""
    return quantity(sigma, "length", "sigma") if isinstance(sigma, str) else sigma


def split_column(header: str) -> tuple[str, str | None]:
    """Split the column header `name [unit]` into name and unit (None where there is none).

    The unit is in the last pair of brackets; a number there is no unit. Other programs write round brackets, which
    count only where a known unit is in them, or a slash before a unit of length or angle.

    >>> split_column("tool_x [mm]"), split_column("tool_x (mm)"), split_column("tool_x/mm")
    (('tool_x', 'mm'), ('tool_x', 'mm'), ('tool_x', 'mm'))
    >>> split_column("joint (left)"), split_column("/arm/joint"), split_column("q[0]")
    (('joint (left)', None), ('/arm/joint', None), ('q[0]', None))
    """
    match = _COLUMN.match(header)
    assert match is not None  # the pattern takes any text
    name, unit = match.group("name"), match.group("unit")
    if unit is not None and unit.isdecimal():
        return header.strip(), None
    other = _OTHERWISE.match(name) if unit is None else None
    if other is not None and (known := (other["unit"] or other["slash"] or "").strip()) in _UNITS:
        return other["name"] or other["lead"], known
    return name, unit


@dataclass(frozen=True)
class MappedColumn:
    """A column: the robot's value is factor * cell + offset.

    Attributes:
        name: Joint or coordinate that it holds.
        unit: Unit of the offset, and of cells that state none.
        factor: Factor with its sign.
        offset: Offset in that unit.
    """

    name: str
    unit: str | None
    factor: float = 1.0
    offset: float = 0.0

    @property
    def plain(self) -> bool:
        """Whether the cell is the value."""
        return self.factor == 1.0 and self.offset == 0.0

    @property
    def words(self) -> str:
        """The value in words, such as `90 - 0.5 * the cell, in deg`."""
        shift = f" {'+' if self.offset > 0 else '-'} {abs(self.offset):g}" if self.offset else ""
        size = "" if abs(self.factor) == 1 else f"{abs(self.factor):g} * "
        return f"{'-' if self.factor < 0 else ''}{size}the column{shift}{f' {self.unit}' if self.unit else ''}"


def mapped_column(text: str) -> MappedColumn:
    """Read what a column stands for: `name [unit]`, `-name [deg]`, `name + 90 [deg]`, `-0.5 * name - 3 [deg]`.

    Signs before a number need a blank before them, since names may have them.

    >>> mapped_column("-0.5 * elbow + 90 [deg]")
    MappedColumn(name='elbow', unit='deg', factor=-0.5, offset=90.0)
    """
    name, unit = split_column(text)
    match = _FORM.fullmatch(name.strip())
    if match is None:
        return MappedColumn(name, unit)
    factor = float(match["factor"] or 1.0) * (-1.0 if match["sign"] else 1.0)
    offset = float(match["offset"] or 0.0) * (-1.0 if match["way"] == "-" else 1.0)
    return MappedColumn(match["name"], unit, factor, offset)


def in_unit(value: Values, unit: str) -> Values:
    """Return an SI value, or an array of them, in a unit of `PER_SI`, such as `deg`."""
    return value * _SCALES[unit]


def from_unit(value: Values, unit: str) -> Values:
    """Return a value, or an array of them, in a unit of `PER_SI`, such as `mm`, in SI."""
    return value / _SCALES[unit]


def quantity_text(value: float, unit: str, form: str = ".3g") -> str:
    """Return an SI value in a unit of `PER_SI`, such as `mm` or `ERROR_UNIT[dimension]`, with that unit after it.

    >>> quantity_text(0.000123456, "mm"), quantity_text(0.5, "deg", ".1f")
    ('0.123 mm', '28.6 deg')
    """
    return f"{in_unit(value, unit):{form}} {unit}"


def millimetres(length: Values) -> Values:
    """Return a length, or an array of lengths, [m] in mm."""
    return in_unit(length, "mm")
