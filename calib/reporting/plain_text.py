"""Text tables without colours, in which every character of a name or unit stays as it is."""

from __future__ import annotations

import io
from collections.abc import Iterable

from rich.console import Console
from rich.table import Table


def plain_text(parts: Iterable[str | Table], width: int, *, wrap: bool = False) -> str:
    """Return lines and tables as plain text.

    `[mm]`, or a name in brackets, is no markup here, and `:name:` no picture.

    Args:
        parts: In the order of printing.
        width: Of the tables, in characters.
        wrap: Whether lines of text are broken at this width too.
    """
    stream = io.StringIO()
    console = Console(file=stream, width=width, color_system=None, markup=False, emoji=False, highlight=False)
    for part in parts:
        console.print(part, soft_wrap=isinstance(part, str) and not wrap)
    return stream.getvalue()
