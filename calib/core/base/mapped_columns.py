"""Foreign columns as a description maps them: name here, unit, sign, factor and zero."""

from __future__ import annotations

import re
from dataclasses import dataclass

from calib.core.base.units import split_column

_NUMBER = r"\d+(?:\.\d*)?(?:[eE][-+]?\d+)?|\.\d+"
_FORM = re.compile(
    rf"(?P<sign>-\s*)?(?:(?P<factor>{_NUMBER})\s*\*\s*)?(?P<name>\S(?:.*?\S)?)(?:\s+(?P<way>[-+])\s*(?P<offset>{_NUMBER}))?"
)


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
