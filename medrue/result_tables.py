"""Tables of a study: one object that becomes CSV, JSON and a piece of a page."""

from __future__ import annotations

import math
from dataclasses import dataclass

from calib.core.data.table_writing import format_table

Cell = str | float | None


@dataclass(frozen=True)
class TableColumn:
    """One column.

    Attributes:
        header: Name, with its unit in brackets.
        values: Its cells; None where there is nothing to say.
        digits: Digits after the point when people read it; files have all digits.
    """

    header: str
    values: tuple[Cell, ...]
    digits: int = 3

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

    def __post_init__(self) -> None:
        if len({len(column.values) for column in self.columns}) != 1:
            raise ValueError(f"table {self.name}: columns of different lengths")

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
        cells = zip(*(column.values for column in self.columns), strict=True)
        records = [dict(zip(headers, (_plain(cell) for cell in row), strict=True)) for row in cells]
        return {"title": self.title, "notes": list(self.notes), "rows": records}

    def text(self) -> str:
        """Return the table as text for a terminal."""
        cells = [[column.header, *column.cell_texts()] for column in self.columns]
        widths = [max(len(cell) for cell in column) for column in cells]
        lines = []
        for row in zip(*cells, strict=True):
            parts = [
                cell.ljust(width) if i == 0 else cell.rjust(width)
                for i, (cell, width) in enumerate(zip(row, widths, strict=True))
            ]
            lines.append("  ".join(parts).rstrip())
        return "\n".join(lines)


def _plain(cell: Cell) -> Cell:
    return None if isinstance(cell, float) and not math.isfinite(cell) else cell
