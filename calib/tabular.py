"""Rows of named cells as tables for notebooks (HTML) and for pandas."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from importlib import import_module
from typing import Any

from calib.errors import InputError


def table_html(rows: Sequence[dict[str, object]]) -> str:
    """Return rows as an HTML table; nothing in them is markup."""
    if not rows:
        return "<table></table>"
    head = "".join(f"<th>{html.escape(key)}</th>" for key in rows[0])
    body = "".join("<tr>" + "".join(f"<td>{_cell(cell)}</td>" for cell in row.values()) + "</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def titled_html(title: str, lines: Sequence[str], *tables: Sequence[dict[str, object]]) -> str:
    """Return a heading, lines and tables as HTML; nothing in them is markup."""
    told = "".join(f"<p>{html.escape(line)}</p>" for line in lines)
    return f"<h3>{html.escape(title)}</h3>{told}{''.join(table_html(rows) for rows in tables)}"


def data_frame(rows: Sequence[dict[str, object]], index: str = "name") -> Any:
    """Return rows as a pandas table; pandas missing is an `InputError`.

    Args:
        rows: With the same keys.
        index: The key whose cells name the rows.
    """
    return pandas().DataFrame(list(rows)).set_index(index)


def pandas() -> Any:
    """Return pandas; its absence is an `InputError`."""
    try:
        return import_module("pandas")
    except ImportError:
        raise InputError("pandas is not installed; `pip install pandas` first") from None


def _cell(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.5g}" if math.isfinite(value) else "-"
    return html.escape(str(value))
