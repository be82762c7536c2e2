"""A table of a report as content: text and pages show the same rows, each in its own way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from rich.table import Table

from calib.core.base.words import text_table


@dataclass(frozen=True)
class GridNumber:
    """A number of a table.

    Attributes:
        value: The number; NaN where it is not known.
        std: Its standard deviation, by which a page rounds; None for three significant digits.
        decimals: Format in text.
        page_decimals: Fixed number of decimals on a page, if any.
    """

    value: float
    std: float | None = None
    decimals: str = ".4f"
    page_decimals: int | None = None

    @property
    def text(self) -> str:
        """The number as text."""
        return f"{self.value:{self.decimals}}" if np.isfinite(self.value) else "-"


@dataclass(frozen=True)
class GridColumn:
    """A column of a table.

    Attributes:
        on_page: Its header on a page, where it differs.
        words: Whether its cells are words, which stand on the left.
        only_page: Whether text leaves it out.
    """

    head: str
    on_page: str = ""
    words: bool = False
    only_page: bool = False


@dataclass(frozen=True)
class Grid:
    """A table.

    Attributes:
        title: Text above it on a terminal.
        caption: Text above it on a page.
        counting: Numbers of the rows that matter most; a page marks them.
    """

    title: str
    caption: str
    columns: tuple[GridColumn, ...]
    rows: tuple[tuple[str | GridNumber, ...], ...]
    counting: tuple[int, ...] = ()

    def as_text(self, *, plain: bool = False) -> Table:
        """Return the table for a terminal, without lines if `plain`."""
        shown = [k for k, column in enumerate(self.columns) if not column.only_page]
        heads = [self.columns[k].head for k in shown]
        words = [self.columns[k].head for k in shown if self.columns[k].words]
        table = text_table(heads, words, self.title, plain=plain)
        for row in self.rows:
            table.add_row(*(cell if isinstance(cell, str) else cell.text for cell in (row[k] for k in shown)))
        return table
