"""Numbers and lists in sentences."""

from __future__ import annotations

from collections.abc import Sequence

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
