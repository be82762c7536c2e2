"""Numbers and lists in sentences, and text tables without colours, in which every character stays as it is."""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence

from rich.console import Console
from rich.table import Table

_LISTED = 5


def counted(number: int, singular: str, plural: str | None = None) -> str:
    """Return a number with its noun.

    Args:
        number: How many.
        singular: The noun for one.
        plural: For any other number; the singular with an s if not given.

    Examples:
        >>> counted(1, "pose"), counted(3, "pose"), counted(2, "minimum", "minima")
        ('1 pose', '3 poses', '2 minima')
    """
    return f"{number} {singular if number == 1 else plural or singular + 's'}"


def listed(names: Sequence[str], separator: str = ", ", shown: int = _LISTED) -> str:
    """Return the first few of many."""
    return separator.join(names[:shown]) + (f"{separator}..." if len(names) > shown else "")


def sentence(clause: str) -> str:
    """Return a clause with a capital and a full stop."""
    return f"{clause[0].upper()}{clause[1:]}."


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
