"""Tables of a study: one object that becomes CSV, JSON and a piece of a page."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import cast

from calib.core.data.table_writing import format_table

Cell = str | float | None


@dataclass(frozen=True)
class TableColumn:
    """One column.

    Attributes:
        header: Name, with its unit in brackets.
        values: Its cells, which may be given as an array; None where there is nothing to say, as for NaN.
        digits: Digits after the point when people read it; files have all digits.
    """

    header: str
    values: Iterable[Cell]
    digits: int = 3

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", tuple(map(_plain, self.values)))

    def cell_texts(self) -> list[str]:
        """Return the cells as people read them."""
        return [
            "" if cell is None else cell if isinstance(cell, str) else f"{cell:.{self.digits}f}" for cell in self.values
        ]


@dataclass(frozen=True)
class ResultTable:
    """A table.

    Attributes:
        name: Name of its files, without ending.
        title: Title.
        columns: Columns of equal length.
        notes: Notes for readers.
    """

    name: str
    title: str
    columns: tuple[TableColumn, ...]
    notes: tuple[str, ...] = ()

    def rows(self) -> list[list[str]]:
        """Return the rows as people read them."""
        return [list(row) for row in zip(*(column.cell_texts() for column in self.columns), strict=True)]

    def csv(self) -> str:
        """Return the table as CSV, cells without a value being empty."""
        columns = [(column.header, ["" if cell is None else cell for cell in column.values]) for column in self.columns]
        return format_table(columns, (self.title, *self.notes))

    def to_dict(self) -> dict[str, object]:
        """Return the table as plain data for JSON."""
        headers = [column.header for column in self.columns]
        rows = zip(*(column.values for column in self.columns), strict=True)
        records = [dict(zip(headers, row, strict=True)) for row in rows]
        return {"title": self.title, "notes": list(self.notes), "rows": records}

    def text(self) -> str:
        """Return the table as text for a terminal."""
        rows = [[column.header for column in self.columns], *self.rows()]
        first, *others = (max(map(len, cells)) for cells in zip(*rows, strict=True))
        lines = []
        for row in rows:
            cells = [row[0].ljust(first), *(cell.rjust(width) for cell, width in zip(row[1:], others, strict=True))]
            lines.append("  ".join(cells).rstrip())
        return "\n".join(lines)


def _plain(cell: Cell) -> Cell:
    """A cell without numpy's types; None for a number that is not finite."""
    if cell is None or isinstance(cell, str):
        return cell
    return cast(Cell, cell.item() if hasattr(cell, "item") else cell) if math.isfinite(cell) else None
