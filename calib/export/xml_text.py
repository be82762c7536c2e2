"""Numbers and comments as XML text."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence


def numbers(values: Iterable[float]) -> str:
    """Return the shortest decimals that read back to the same floats, separated by spaces."""
    return " ".join(repr(float(value)) if value != 0 else "0" for value in values)


def comment(lines: Sequence[str]) -> str:
    """Return an XML comment, one line each; ASCII, so that it fits every encoding."""
    text = "\n".join(lines).encode("ascii", "backslashreplace").decode()
    return "<!-- " + re.sub(r"-(?=-|$)", "- ", text) + "\n-->"
