"""The accuracy that a file asks for, in a comment: `# tolerance: 0.1 mm`."""

from __future__ import annotations

import re
from collections.abc import Iterable
from difflib import get_close_matches

from calib.core.base.errors import CalibrationError, DataError
from calib.core.base.units import quantity

_KEY = "tolerance"
_STATED = re.compile(r"^(\w+)\s*[:=]\s*(.*\S)\s*$")
_ALIKE = 0.8


def stated_tolerance(comments: Iterable[str], path: str, error: type[CalibrationError] = DataError) -> float | None:
    """Return the smallest tolerance that comments (without their #) of a file state [m]; None where none does.

    One that is not a positive length with a unit, or whose key is misspelled, raises the `error`, a `CalibrationError`.
    """
    found = []
    for key, text in (match.groups() for match in map(_STATED.match, comments) if match):
        if not get_close_matches(key.casefold(), [_KEY], cutoff=_ALIKE):
            continue
        if key.casefold() != _KEY:
            raise error(f"{path}: comment '{key}: {text}': did you mean '{_KEY}'?")
        where = f"{path}: comment '{key}: {text}'"
        size = quantity(text, "length", where, error) if re.search(r"[^\d.eE+-]", text) else 0.0
        if size <= 0:
            raise error(
                f"{where}: is not a positive length with a unit; write '# {_KEY}: 0.1 mm', or leave the line out"
            )
        found.append(size)
    return min(found, default=None)
